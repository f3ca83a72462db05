"""What Newton's solvers miss of the conformance scenarios: by how much, with a margin, and why."""

from __future__ import annotations

from orbit_core.interfaces import Gap

_ROUNDING = "rounding in single precision adds up over twenty solver steps in each physics step"
_FIRST_ORDER = "free and articulated motion is integrated in first order"
_HELD = (
    "an effort is held over the twenty solver steps of a physics step, so that a controller outside lags by half of one"
)
_VISCOUS = "friction is viscous below joint_friction_speed, 0.005 rad/s (m/s)"
_CREEP = "friction grows with the speed of slip up to Coulomb's limit, no more steeply than the step resolves"
_ONE_COEFFICIENT = "there is one coefficient of sliding friction, the dynamic one"
_SPRING = "contacts are springs and dampers, no stiffer than the step resolves"
_FOUND = (
    "contacts are found once in a physics step and stay in place within it: at a quarter of the step, a quarter of the "
    "miss"
)
_TRIPOD = "a tripod alone, in one of three directions at friction 0.8: its feet stand on springs"
_STATICS = "joint wrenches are of statics: what accelerates the links is left out"

FEATHERSTONE_GAPS = (
    Gap("free_fall", "velocity", 2e-4, _ROUNDING),
    Gap("projectile", "spin", 2.2e-3, _FIRST_ORDER),
    Gap("spinning_bodies", "path", 3e-4, _ROUNDING),
    Gap("floating_chain", "linear_momentum", 6e-4, _FIRST_ORDER),
    Gap("floating_chain", "path", 3e-4, _FIRST_ORDER),
    Gap("joint_actuation", "revolute", 8e-5, _ROUNDING),
    Gap("joint_actuation", "prismatic", 6e-5, _ROUNDING),
    Gap("reflected_inertia", "single", 6e-5, _ROUNDING),
    Gap("effort_limits", "acceleration", 3e-5, _ROUNDING),
    Gap("mass_per_environment", "force", 3e-5, _ROUNDING),
    Gap("gravity_per_environment", "velocity", 4e-5, _ROUNDING),
    Gap("joint_friction", "sliding", 2e-3, _VISCOUS),
    Gap("joint_friction", "creep", 6e-3, _VISCOUS),
    Gap("joint_friction", "pushed", 1.6e-3, _VISCOUS),
    Gap("joint_friction", "driven", 1.8e-5, _ROUNDING),
    Gap("explicit_drive", "final", 0.014, _HELD),
    Gap("stick_and_slip", "creep", 0.026, _CREEP),
    Gap("stopping_distance", "distance", 0.11, _TRIPOD),
    Gap("static_above_dynamic", "slip", 0.46, _ONE_COEFFICIENT),
    Gap("ball_on_slope", "rolling", 0.042, _FOUND),
    Gap("ball_on_slope", "slipping", 8e-3, _FOUND),
    Gap("sliding_to_rolling", "end", 0.024, _FOUND),
    Gap("sliding_to_rolling", "way", 0.03, _FOUND),
    Gap("rolling_resistance", "deceleration", 0.23, _FOUND),
    Gap("unequal_collision", "speeds", 0.04, _SPRING),
    Gap("resting_weight", "drift", 2.2e-4, _CREEP),
    Gap("stack", "penetration", 1.1e-3, _SPRING),
    Gap("grasp", "lift", 3.8e-3, _CREEP),
    Gap("contact_force_with_friction", "force", 5e-3, _CREEP),
    Gap("imu_falling_and_at_rest", "falling", 2.1e-3, _ROUNDING),
    Gap("imu_falling_and_at_rest", "resting", 8e-5, _ROUNDING),
    Gap("force_torque_of_a_spinning_arm", "force", 8e-3, _STATICS),
    Gap("force_torque_of_a_spinning_arm", "torque", 3.2e-3, _STATICS),
)

XPBD_GAPS: tuple[Gap, ...] = ()
