"""From what a command counts: from home, from what is measured, or from what was asked for last."""

from __future__ import annotations

from collections.abc import Mapping
from enum import Enum

import torch
from torch import Tensor

from orbit_core.dynamics.indexing import write_rows


class CommandMode(Enum):
    """What a command is added to."""

    ABSOLUTE = "absolute"
    """Home, or zero: the same command always asks for the same."""
    RELATIVE = "relative"
    """What is measured: nothing winds up, and under a steady load zero commands creep."""
    INTEGRATED = "integrated"
    """What was asked for last, from what is measured at the beginning of an episode: nothing creeps."""


class LastTargets:
    """What was asked for last, (N, *shape); what is measured in environments that have just begun.

    The measured state is taken at the first turn and not at the reset, for events may place the joints after it.
    """

    def __init__(self, num_envs: int, shape: tuple[int, ...], device: torch.device) -> None:
        self._targets = torch.zeros(num_envs, *shape, device=device)
        self._stale = torch.ones(num_envs, *(1 for _ in shape), dtype=torch.bool, device=device)

    def read(self, measured: Tensor) -> Tensor:
        """(N, *shape)"""
        return torch.where(self._stale, measured, self._targets)

    def parts(self) -> dict[str, Tensor]:
        """What :meth:`read_of` takes, for laws that are functions of tensors."""
        return {"targets": self._targets, "stale": self._stale}

    @staticmethod
    def read_of(parts: Mapping[str, Tensor], measured: Tensor) -> Tensor:
        """(N, *shape) of :meth:`parts`."""
        return torch.where(parts["stale"], measured, parts["targets"])

    def keep(self, targets: Tensor) -> None:
        """Remember what is asked for now."""
        self._targets.copy_(targets)
        self._stale.zero_()

    def reset(self, env_ids: Tensor | None) -> None:
        """Forget what some environments were asked for."""
        write_rows(self._stale, True, env_ids)

    def memory(self) -> Mapping[str, Tensor]:
        """For :meth:`orbit_core.interfaces.Node.memory`."""
        return {"targets": self._targets, "stale": self._stale}
