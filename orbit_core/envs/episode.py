"""Results of episodes, what a step reports of them, and episodes that are lost because the engine diverged."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass

import torch
from torch import Tensor

from orbit_core.envs.observation_layout import Observation, map_leaves
from orbit_core.interfaces import ConfigurationError, World

# Name of the metric that is 1 where an episode began on the expert's way, else 0.
EXPERT_START = "expert_start"


@dataclass(frozen=True)
class EpisodeEnd:
    """Results of n episodes."""

    env_ids: Tensor
    """(n,)"""
    observation: Observation
    """Observation of the last state, before the reset, with n rows."""
    success: Tensor
    """(n,) bool"""
    metrics: dict[str, Tensor]
    """(n,) each."""
    rewards: dict[str, Tensor]
    """(n,) each term's contribution to the return."""
    steps: Tensor
    """(n,) int64"""

    @property
    def usual(self) -> Tensor:
        """(n,) bool: which began as the task says, not on the expert's way; learning curves count these."""
        there = self.metrics.get(EXPERT_START)
        return torch.ones_like(self.success) if there is None else there == 0.0

    def only(self, rows: Tensor) -> EpisodeEnd:
        """The ends in the rows (k,), by index."""
        return EpisodeEnd(
            env_ids=self.env_ids[rows],
            observation=map_leaves(lambda value: value[rows], self.observation),
            success=self.success[rows],
            metrics=_rows_of(self.metrics, rows),
            rewards=_rows_of(self.rewards, rows),
            steps=self.steps[rows],
        )


class StepInfo(Mapping[str, EpisodeEnd]):
    """Holds an :class:`EpisodeEnd` under ``"final"`` where an episode ended in the step, and else nothing.

    It is looked for when it is asked for, and only that waits for the device. Who would not wait takes :attr:`done` and
    :attr:`everyone`.
    """

    def __init__(self, done: Tensor, everyone: EpisodeEnd) -> None:
        self.done = done
        """(N,) bool: whose episode ended."""
        self.everyone = everyone
        """Ends of all environments' episodes, as if each had ended with this step."""
        self._final: EpisodeEnd | None = None
        self._looked = False

    @property
    def _found(self) -> EpisodeEnd | None:
        if not self._looked:
            # This waits for the device, which is why it happens only when somebody asks.
            rows = self.done.nonzero().squeeze(-1)
            self._final = self.everyone.only(rows) if len(rows) else None
            self._looked = True
        return self._final

    def __getitem__(self, key: str) -> EpisodeEnd:
        if key != "final" or self._found is None:
            raise KeyError(key)
        return self._found

    def __iter__(self) -> Iterator[str]:
        return iter(() if self._found is None else ("final",))

    def __len__(self) -> int:
        return int(self._found is not None)

    def __repr__(self) -> str:
        return repr(dict(self))


def _rows_of(values: dict[str, Tensor], rows: Tensor) -> dict[str, Tensor]:
    return {name: value[rows] for name, value in values.items()}


class LostEpisodes:
    """Restart of environments whose simulation diverged within a step, while the others go on.

    The world is back at its start by the time that terms look at it. The episode counts as truncated, for what the
    robot did is not known to be wrong: its last step earns nothing, it is no success, and no curriculum learns from it.

    Args:
        world: one that is simulated.

    Raises:
        ConfigurationError: the world cannot diverge.
    """

    def __init__(self, world: World) -> None:
        guard = getattr(world, "guard_divergence", None)
        if guard is None:
            raise ConfigurationError("a world that is not simulated does not diverge: leave reset_diverged out")
        self.now: Tensor = guard()
        """(N,) bool: whose simulation diverged in this step."""
        self._count = torch.zeros(1, dtype=torch.int64, device=world.device)

    @property
    def count(self) -> int:
        """Number of lost episodes so far; waits for the device."""
        return int(self._count)

    def forget(self) -> None:
        """Begin a step."""
        self.now.fill_(False)

    def end(self, reward: Tensor, terminated: Tensor, late: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """Reward (N,), terminated (N,) and out of time (N,), with the lost episodes cut short; counts them."""
        # Added on the device: reading the number is left to :attr:`count`.
        self._count.add_(self.now.sum())
        return reward.masked_fill(self.now, 0.0), terminated & ~self.now, late | self.now
