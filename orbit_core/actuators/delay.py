"""Commands held back by a number of physics steps that each environment draws at reset."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import torch
from torch import Tensor

from orbit_core.dynamics.indexing import write_block, write_rows
from orbit_core.dynamics.random import RandomStreams
from orbit_core.interfaces import ConfigurationError
from orbit_core.scene import IdealPd


@dataclass(frozen=True)
class DelayState:
    """A snapshot of a delay line."""

    history: Tensor
    delays: Tensor
    age: Tensor


class CommandDelay:
    """A delay line for targets (3, N, k).

    Joints of one group (the same object) share a delay. The first command after a reset counts as held since ever.

    Args:
        groups: the actuator group of each joint (k,).
        num_envs: N.
        random: draws the delays.
    """

    def __init__(self, groups: Sequence[IdealPd], num_envs: int, random: RandomStreams) -> None:
        for group in groups:
            if not 0 <= group.min_delay <= group.max_delay:
                raise ConfigurationError(
                    f"the delay of actuators {group.joints} must satisfy 0 <= min_delay <= max_delay, not "
                    f"{group.min_delay}, {group.max_delay}"
                )
        self._groups = list({id(group): group for group in groups}.values())
        members = [[j for j, other in enumerate(groups) if other is group] for group in self._groups]
        self._random = random
        device = random.device
        self._length = max((group.max_delay for group in groups), default=0) + 1
        self._history = torch.zeros(self._length, 3, num_envs, len(groups), device=device)
        self._delays = torch.zeros(num_envs, len(groups), dtype=torch.int64, device=device)
        self._age = torch.zeros(num_envs, 1, dtype=torch.int64, device=device)
        self._columns = [torch.tensor(columns, device=device) for columns in members]
        self.reset(None)

    def reset(self, env_ids: Tensor | None) -> None:
        """Forget commands and draw new delays."""
        write_rows(self._age, 0, env_ids)
        for group, columns in zip(self._groups, self._columns, strict=True):
            drawn = self._random.integers(group.min_delay, group.max_delay, env_ids)
            write_block(self._delays, columns, drawn[:, None], env_ids)

    def push(self, targets: Tensor) -> Tensor:
        """Take the commands of this step (3, N, k) and return those in effect."""
        newest = torch.remainder(self._age, self._length)  # each environment writes in turn, from its reset on
        self._history.scatter_(0, newest.expand(1, *targets.shape), targets[None])
        steps_back = torch.minimum(self._delays, self._age)
        slots = torch.remainder(self._age - steps_back, self._length)
        self._age += 1
        return self._history.gather(0, slots.expand(1, 3, *slots.shape)).squeeze(0)

    def save_state(self) -> DelayState:
        """A detached copy."""
        return DelayState(self._history.clone(), self._delays.clone(), self._age.clone())

    def load_state(self, state: DelayState) -> None:
        """Return to a saved state."""
        self._history.copy_(state.history)
        self._delays.copy_(state.delays)
        self._age.copy_(state.age)
