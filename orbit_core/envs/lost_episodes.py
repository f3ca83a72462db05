"""Episodes that end because the engine diverged in them: cut short, worth nothing, and counted."""

from __future__ import annotations

import torch
from torch import Tensor

from orbit_core.interfaces import ConfigurationError, World


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
        self._count.add_(self.now.sum())
        return reward.masked_fill(self.now, 0.0), terminated & ~self.now, late | self.now
