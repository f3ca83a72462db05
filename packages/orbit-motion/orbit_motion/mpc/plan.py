"""What a predictive controller makes of one state: a motion ahead, and what stands against it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]
# rad or m by which a plan may pass a limit of position: limits are costs, and costs yield a little.
_BEYOND = 0.02
# Times a limit of velocity.
_TOO_FAST = 1.1


@dataclass(frozen=True, eq=False)
class Plan:
    """A motion of k joints from now on."""

    positions: Array
    """(T + 1, k)"""
    velocities: Array
    """(T + 1, k)"""
    efforts: Array
    """(T, k)"""
    dt: float
    """s from one to the next."""
    missing: tuple[float, float]
    """m and rad by which the end misses the goal."""
    problem: str = ""
    """The constraint that the plan breaks; empty if it keeps all."""

    def at(self, time: float) -> tuple[Array, Array, Array]:
        """Return positions, velocities and efforts (k,) so many seconds on; the end is held."""
        place = min(time / self.dt, len(self.efforts))
        before = min(int(place), len(self.efforts) - 1)
        share = place - before
        positions, velocities = (
            (1.0 - share) * part[before] + share * part[before + 1] for part in (self.positions, self.velocities)
        )
        return positions, velocities, self.efforts[before]


@dataclass(frozen=True, eq=False)
class Limits:
    """Of k joints, by name."""

    names: Sequence[str]
    lowest: Array
    highest: Array
    velocity: Array
    effort: Array

    def problem(self, positions: Array, velocities: Array, efforts: Array) -> str:
        """Return the limit that a motion (T, k) breaks most; empty if none."""
        if not all(np.isfinite(part).all() for part in (positions, velocities, efforts)):
            return "the solver found no motion: its numbers are not finite"
        beyond = np.maximum(self.lowest - positions, positions - self.highest).max(0)
        fast = (np.abs(velocities) / self.velocity).max(0)
        strong = (np.abs(efforts) / self.effort).max(0)
        if beyond.max() > _BEYOND:
            return f"joint '{self.names[int(beyond.argmax())]}' would pass its limit by {beyond.max():.3g} rad or m"
        if fast.max() > _TOO_FAST:
            return f"joint '{self.names[int(fast.argmax())]}' would move at {fast.max():.3g} times its velocity limit"
        if strong.max() > _TOO_FAST:
            return f"joint '{self.names[int(strong.argmax())]}' would need {strong.max():.3g} times its effort limit"
        return ""
