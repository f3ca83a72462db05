"""Materials as MuJoCo's contact parameters.

MuJoCo gives a pair the larger of each friction coefficient and of ``condim``, the contract's own rule. Its contacts are
spring-dampers in acceleration: with impedance d and ``solref = (-k, -b)`` a body that would accelerate with a0 does so
with ``(1 - d) a0 - k depth - b velocity``. Where one shape of a pair gives that form, it overrides the other's
default, and of two the stiffer and more damped parts win.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from orbit_core.interfaces import Approximation
from orbit_core.scene import Capsule, Compliance, Cylinder, PhysicsMaterial, Shape, Sphere
from orbit_mjmodel.config import ModelConfig

STEPS_PER_BOUNCE = 8
"""Physics steps that a rebound lasts, enough for the integrator to resolve it, where :mod:`orbit_mjmodel.rebounds` has
no pair: on cloth, with the integrator RK4 or pyramidal cones, and on shapes that differ between environments."""
# Damping ratio above which the integrator would not follow; it rebounds at a tenth of the speed.
_MOST_DAMPED = 1.3
SOFT_IMPEDANCE = 0.1
"""Impedance of a compliant contact: the share of a load that it cancels outright rather than by giving way."""
OVERRIDING = 1e6
"""Weight of an impedance that is to hold whatever the other shape's is."""


@dataclass(frozen=True)
class ContactParameters:
    """The contact parameters of a geom."""

    friction: tuple[float, float, float]
    """Sliding, torsional (m) and rolling (m)."""
    condim: int
    """Dimension of the contact: 1, 3, 4 or 6 with rolling friction."""
    solref: tuple[float, float]
    """Time constant and damping ratio, or minus stiffness and damping."""
    solimp: tuple[float, float, float, float, float]
    """Impedance: ``dmin``, ``dmax``, ``width``, ``midpoint``, ``power``."""
    solmix: float = 1.0
    """Weight of ``solimp`` against the other shape's."""


def contact_parameters(
    shape: Shape, mass: float, rolls: bool, dt: float, config: ModelConfig, least_friction: float = 0.0
) -> ContactParameters:
    """Contact parameters of a shape on a body of ``mass`` kg; ``rolls`` says whether the body is free to roll.

    No coefficient of friction is below ``least_friction``.
    """
    material = shape.material
    asked = (material.dynamic_friction, material.torsional_friction, material.rolling_friction)
    sliding, torsional, rolling = (max(value, least_friction) for value in asked)
    friction = (sliding, torsional, rolling)
    condim = _condim(shape, rolls)
    if material.compliance:
        spring = _spring(material.compliance, mass)
        return ContactParameters(friction, condim, spring, _impedance(SOFT_IMPEDANCE), OVERRIDING)
    if material.restitution:
        return ContactParameters(friction, condim, _rebound(material.restitution, dt), _impedance(0.99), OVERRIDING)
    return ContactParameters(friction, condim, config.contact_solref, config.contact_solimp)


def material_approximations(shape: Shape, subject: str, one_step: bool) -> list[Approximation]:
    """List the approximations in MuJoCo of a shape's material; ``one_step``: it rebounds by explicit pairs."""
    material = shape.material
    found: list[Approximation] = []
    if material.static_friction != material.dynamic_friction:
        asked = f"static friction {material.static_friction}, dynamic {material.dynamic_friction}"
        got = f"{material.dynamic_friction} for both"
        found.append(Approximation(subject, asked, got, "MuJoCo has one coefficient of sliding friction"))
    if material.compliance:
        asked = f"stiffness {material.compliance.stiffness} N/m, damping {material.compliance.damping} N s/m"
        got = "these values where a single body of this link's mass meets an immovable one"
        why = "MuJoCo scales contact stiffness with the effective mass, and damps sliding as it damps the normal"
        found.append(Approximation(subject, asked, got, why))
    elif material.restitution:
        got = "a rebound within a step, faster where a low friction lets it slide on"
        why = "MuJoCo's convex friction cone pushes what slides off the surface"
        if not one_step:
            got = f"a rebound of {STEPS_PER_BOUNCE} steps with little friction; of two restitutions, the weaker"
            why = "MuJoCo's contacts are spring-dampers"
        found.append(Approximation(subject, f"restitution {material.restitution}", got, why))
    return found


def _condim(shape: Shape, rolls: bool) -> int:
    """3 slides, 4 adds torsion, 6 adds rolling: each step up costs solver rows, so rolling only where it can act."""
    material = shape.material
    if rolls and isinstance(shape.geometry, Sphere | Capsule | Cylinder) and material.rolling_friction:
        return 6
    if material.rolling_friction > PhysicsMaterial.rolling_friction:
        return 6
    return 4 if material.torsional_friction else 3


def _impedance(value: float) -> tuple[float, float, float, float, float]:
    """The same at every depth."""
    return (value, value, 0.001, 0.5, 2.0)


def _spring(compliance: Compliance, mass: float) -> tuple[float, float]:
    """The spring of a contact: at rest ``(1 - d) g = k depth``, which is to be ``stiffness depth / mass``."""
    scale = (1 - SOFT_IMPEDANCE) / mass
    return (-compliance.stiffness * scale, -compliance.damping * scale)


def _rebound(restitution: float, dt: float) -> tuple[float, float]:
    """The spring-damper that throws back at ``restitution`` times the speed of impact."""
    least, greatest = 0.0, _MOST_DAMPED
    for _ in range(40):
        ratio = (least + greatest) / 2
        least, greatest = (ratio, greatest) if _restitution(ratio) > restitution else (least, ratio)
    frequency = math.pi / (STEPS_PER_BOUNCE * dt)
    return (-frequency * frequency, -2 * greatest * frequency)


def _restitution(ratio: float) -> float:
    """Restitution of a linear spring-damper that pushes but does not pull (Schwager and Poeschel, 2007)."""
    if abs(ratio - 1) < 1e-6:
        return math.exp(-2)
    if ratio < 1:
        angle = math.asin(ratio)
        return math.exp(-math.tan(angle) * (math.pi - 2 * angle))
    root = math.sqrt(ratio * ratio - 1)
    return math.exp(-ratio / root * math.log((ratio + root) / (ratio - root)))
