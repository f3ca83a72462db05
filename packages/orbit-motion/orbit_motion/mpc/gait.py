"""Which feet stand when: a contact sequence that repeats."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from orbit_core.interfaces import ConfigurationError


@dataclass(frozen=True, kw_only=True)
class Gait:
    """Phases that follow each other and begin anew after the last.

    Each is its length in s and the feet that are in the air, by their places in the robot's ``feet``.
    """

    phases: Sequence[tuple[float, tuple[int, ...]]] = ((1.0, ()),)
    step_height: float = 0.05
    """m by which a foot is lifted in the middle of its swing."""

    def check(self, term: str, feet: int) -> None:
        """Refuse what no robot with so many feet can do.

        Raises:
            ConfigurationError: a phase has no length, or names a foot that the robot has not, or no foot would stand.
        """
        if not self.phases:
            raise ConfigurationError(f"action term '{term}': its gait has no phases: give one")
        for length, lifted in self.phases:
            if not length > 0.0:
                raise ConfigurationError(f"action term '{term}': a phase of its gait takes {length:g} s: give more")
            if any(not 0 <= foot < feet for foot in lifted) or len(set(lifted)) >= feet:
                raise ConfigurationError(
                    f"action term '{term}': its gait lifts feet {list(lifted)} of {feet}, numbered from 0: name feet "
                    "that the robot has, and leave one on the ground"
                )


def stance_at(gait: Gait, time: float) -> tuple[tuple[int, ...], float]:
    """Return the feet in the air at a time in s, and the share of their swing that is over."""
    time %= sum(length for length, _ in gait.phases)
    for length, lifted in gait.phases:
        if time < length:
            return lifted, time / length
        time -= length
    return gait.phases[-1][1], 1.0
