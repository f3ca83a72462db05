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

_LATE_WRENCH = "PhysX's joint force is of the beginning of a step, in axes that have turned by omega dt at its end"

_SENSORS = (
    Gap("imu_falling_and_at_rest", "resting", 0.01, "a resting body's velocity flickers in its last digits, 1e-5 m/s"),
    Gap("force_torque_of_a_spinning_arm", "force", 0.15, _LATE_WRENCH),
    Gap("force_torque_of_a_spinning_arm", "torque", 0.06, _LATE_WRENCH),
    Gap(
        "alone_and_among_seven", "difference", 2.0,
        "PhysX's TGS solver sums contacts in another order: last digits differ, and then what a strike comes to",
    ),
)  # fmt: skip

_CONTACT = (
    Gap(
        "static_above_dynamic", "slip", 0.5,
        "PhysX's TGS solver lets a face slip before its whole normal force is there, and then takes the dynamic "
        "coefficient; its PGS, temporal_gauss_seidel=False, holds",
    ),
    Gap("contact_force_with_friction", "force", 0.5, "PhysX tells contacts' normal forces, not those of friction"),
)  # fmt: skip

GAPS: tuple[Gap, ...] = (
    *_RAYS,
    *_CONTACT,
    *_SENSORS,
    *_MOTION,
)
