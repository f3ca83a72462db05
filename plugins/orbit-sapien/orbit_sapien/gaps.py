"""What SAPIEN misses of the conformance scenarios: by how much, with a margin, and why."""

from __future__ import annotations

from orbit_core.interfaces import Gap

_PRISM = "PhysX has no cylinders: SAPIEN's are prisms of 32 sides"

_RAYS = (
    Gap("rays_on_primitives", "distance", 6e-3, _PRISM),
    Gap("rays_on_primitives", "normal", 0.11, _PRISM),
)

_LOADED_DRIVE = (
    "friction under a drive is a force that PhysX applies at the beginning of a step, at whose end the drive has not "
    "caught up with it"
)

_MOTION = (
    Gap("projectile", "spin", 1.5e-3, "PhysX reckons in single precision, and rounds 5e-7 of a spin off at each step"),
    Gap("joint_friction", "driven", 2e-3, _LOADED_DRIVE),
)

GAPS: tuple[Gap, ...] = (
    *_RAYS,
    *_MOTION,
)
