"""General actuators of MJCF, as springs and dampers with an effort limit."""

from __future__ import annotations

import math
from dataclasses import dataclass

_PLAIN_DYNAMICS = ("none", "integrator", "filter", "filterexact")
"""Those whose activation is, in the end, the command or its integral."""

Range = tuple[float, float]
"""The least and the largest value."""


@dataclass(frozen=True)
class ActuatorLaw:
    """``gear * (gain * command + bias)`` on one joint, in the words of MJCF's ``<general>``."""

    gain_type: str
    bias_type: str
    dynamics: str
    gain: tuple[float, ...]
    bias: tuple[float, ...]
    gear: float
    force_range: Range | None = None
    """Of the actuator itself, before the gear; none if unlimited."""
    command_range: Range | None = None
    damping: float = 0.0
    """N m s/rad or N s/m of the actuator, before the gear."""

    def gains(self) -> tuple[float, float] | None:
        """Return stiffness and damping at the joint, or None for another law than a spring and a damper."""
        motor, affine = self.bias_type == "none", self.bias_type == "affine"
        if self.gain_type != "fixed" or self.dynamics not in _PLAIN_DYNAMICS or not (motor or affine):
            return None
        own = self.gear**2 * self.damping
        if motor:
            return 0.0, own
        constant, stiffness, damping = self.bias[0], -self.bias[1], -self.bias[2]
        if constant or stiffness < 0 or damping < 0:
            return None
        position = math.isclose(self.gain[0], stiffness, rel_tol=1e-9)
        velocity = not stiffness and math.isclose(self.gain[0], damping, rel_tol=1e-9)
        if not (position or velocity):
            return None
        return self.gear**2 * stiffness + 0.0, self.gear**2 * damping + own

    def effort_range(self) -> Range:
        """Return the least and the largest effort at the joint; infinite where nothing limits it."""
        ranges: list[Range] = []
        if self.force_range is not None:
            ranges.append(_scaled(self.force_range, self.gear))
        if self.command_range is not None and self.bias_type == "none" and self.gain_type == "fixed":
            ranges.append(_scaled(self.command_range, self.gear * self.gain[0]))
        return max((low for low, _ in ranges), default=-math.inf), min((high for _, high in ranges), default=math.inf)


def _scaled(limits: Range, factor: float) -> Range:
    ends = [limit * factor for limit in limits]
    return min(ends), max(ends)
