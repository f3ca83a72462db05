"""Surface properties for contact and for drawing."""

from __future__ import annotations

from dataclasses import dataclass

Color = tuple[float, float, float, float]
"""Red, green, blue and opacity, each in [0, 1]."""


@dataclass(frozen=True)
class Compliance:
    """A contact that gives way: a spring (N/m) and damper (N s/m) along the contact normal."""

    stiffness: float
    damping: float


@dataclass(frozen=True)
class PhysicsMaterial:
    """Contact properties of a shape.

    Where two shapes meet, the pair takes the larger of the two values of each coefficient (the contract's one combine
    rule). Torsional and rolling friction are lengths in metres; the other coefficients have no unit. Where an engine
    lacks them, a scene that asks for more than these defaults is refused; the defaults are left out there.
    """

    static_friction: float = 1.0
    dynamic_friction: float = 1.0
    torsional_friction: float = 0.005
    rolling_friction: float = 0.0001
    restitution: float = 0.0
    compliance: Compliance | None = None
