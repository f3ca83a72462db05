"""Materials as MuJoCo's contact parameters.

MuJoCo gives a pair the larger of each friction coefficient and of ``condim``, the contract's own rule. Its contacts are
spring-dampers in acceleration: ``solref = (-k, -b)`` asks for the acceleration ``-k depth - b velocity``. Where one
shape of a pair gives that form, it overrides the other's default, and of two the stiffer and more damped parts win.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from orbit_core.interfaces import Approximation
from orbit_core.scene import Capsule, Cylinder, PhysicsMaterial, Shape, Sphere
from orbit_mujoco.config import MujocoConfig

STEPS_PER_BOUNCE = 16
"""Physics steps that a rebound lasts, enough for the integrator to resolve it."""


@dataclass(frozen=True)
class ContactParameters:
    """What a geom takes."""

    friction: tuple[float, float, float]
    condim: int
    solref: tuple[float, float]
    solimp: tuple[float, float, float, float, float]


def contact_parameters(shape: Shape, mass: float, rolls: bool, dt: float, config: MujocoConfig) -> ContactParameters:
    """Contact parameters of a shape on a body of ``mass`` kg; ``rolls`` says whether the body is free to roll."""
    material = shape.material
    friction = (material.dynamic_friction, material.torsional_friction, material.rolling_friction)
    solref, solimp = config.contact_solref, config.contact_solimp
    if material.compliance:
        solref = (-material.compliance.stiffness / mass, -material.compliance.damping / mass)
    elif material.restitution:
        solref, solimp = _rebound(material.restitution, dt), (0.99, 0.99, 0.001, 0.5, 2.0)
    return ContactParameters(friction, _condim(shape, rolls), solref, solimp)


def approximations(shape: Shape, subject: str) -> list[Approximation]:
    """What of the shape's material MuJoCo does not take as it is."""
    material = shape.material
    found: list[Approximation] = []
    if material.static_friction != material.dynamic_friction:
        asked = f"static friction {material.static_friction}, dynamic {material.dynamic_friction}"
        got = f"{material.dynamic_friction} for both"
        found.append(Approximation(subject, asked, got, "MuJoCo has one coefficient of sliding friction"))
    if material.compliance:
        asked = f"stiffness {material.compliance.stiffness} N/m, damping {material.compliance.damping} N s/m"
        got = "these values where a single body of this link's mass meets an immovable one"
        found.append(Approximation(subject, asked, got, "MuJoCo scales contact stiffness with the effective mass"))
    elif material.restitution:
        got = f"a rebound of {STEPS_PER_BOUNCE} steps; where both shapes ask for one, the weaker"
        found.append(
            Approximation(subject, f"restitution {material.restitution}", got, "MuJoCo's contacts are spring-dampers")
        )
    return found


def _condim(shape: Shape, rolls: bool) -> int:
    """3 slides, 4 adds torsion, 6 adds rolling: each step up costs solver rows, so rolling only where it can act."""
    material = shape.material
    if rolls and isinstance(shape.geometry, Sphere | Capsule | Cylinder) and material.rolling_friction:
        return 6
    if material.rolling_friction > PhysicsMaterial.rolling_friction:
        return 6
    return 4 if material.torsional_friction else 3


def _rebound(restitution: float, dt: float) -> tuple[float, float]:
    """The spring-damper whose half period ends at ``-restitution`` times the speed of impact.

    A linear spring-damper of damping ratio z rebounds with ``exp(-pi z / sqrt(1 - z^2))``.
    """
    logarithm = math.log(min(restitution, 1.0))
    ratio = -logarithm / math.hypot(math.pi, logarithm)
    frequency = math.pi / (STEPS_PER_BOUNCE * dt * math.sqrt(1 - ratio * ratio))
    return (-frequency * frequency, -2 * ratio * frequency)
