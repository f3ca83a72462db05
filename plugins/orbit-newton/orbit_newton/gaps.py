"""The metrics of the conformance scenarios that Newton's solvers miss, with limits and reasons."""

from __future__ import annotations

from orbit_core.interfaces import Gap

_ROUNDING = "rounding in single precision adds up over twenty solver steps in each physics step"
_FIRST_ORDER = "free and articulated motion is integrated in first order"
_HELD = "an effort is held over the solver steps of a physics step, so that a controller outside lags by half of one"
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

_DIFFERENCES = (
    "angular velocities are differences of orientations in single precision: a change in a solver step is rounded to "
    "about 1e-4 rad/s"
)
_DAMPED = "positions are corrected first and velocities follow, which damps motion in first order of the solver step"
_SWEEPS = "joints are corrected in sweeps that end short of agreement, which takes energy and angular momentum"
_SHARES = "each sweep applies its share of a drive, and the shares do not add up to the whole"
_ROTORS = f"armature is inertia of the driven link against the world, not against its parent; {_DIFFERENCES}"
_FINGERS = "sweeps pass on too little of the fingers' force: fingers of 0.2 kg do not lift a box of 1 kg"
_SUPPORT = "forces are what the sweeps applied, which share what lies between several things unevenly"
_REBOUND = "what restitution adds to velocities after the sweeps is no part of the forces told"

XPBD_GAPS = (
    Gap("projectile", "spin", 2.1e-3, _DIFFERENCES),
    Gap("spinning_bodies", "energy", 6.3e-3, _DIFFERENCES),
    Gap("floating_chain", "angular_momentum", 0.21, _SWEEPS),
    Gap("floating_chain", "path", 1.8e-4, _SWEEPS),
    Gap("floating_chain", "energy", 0.2, _SWEEPS),
    Gap("pendulum", "small_period", 0.076, _DIFFERENCES),
    Gap("pendulum", "large_period", 0.25, _DAMPED),
    Gap("pendulum", "energy", 0.47, _DAMPED),
    Gap("double_pendulum", "first_second", 1.2, _SWEEPS),
    Gap("double_pendulum", "two_seconds", 1.2, _SWEEPS),
    Gap("double_pendulum", "energy", 0.18, _SWEEPS),
    Gap("joint_actuation", "revolute", 1.5, _DIFFERENCES),
    Gap("reflected_inertia", "single", 2.3, _DIFFERENCES),
    Gap("reflected_inertia", "chain", 0.84, _ROTORS),
    Gap("joint_friction", "sliding", 0.01, _VISCOUS),
    Gap("joint_friction", "creep", 1.5e-3, _VISCOUS),
    Gap("joint_friction", "pushed", 1.5, _DIFFERENCES),
    Gap("joint_friction", "driven", 8.6e-5, _DIFFERENCES),
    Gap("effort_limits", "acceleration", 8e-5, _DIFFERENCES),
    Gap("implicit_drive", "final", 7e-3, _SHARES),
    Gap("explicit_drive", "final", 0.012, _HELD),
    Gap("drive_tracking", "speed", 2.9e-5, _SHARES),
    Gap("static_above_dynamic", "slip", 0.46, _ONE_COEFFICIENT),
    Gap("ball_on_slope", "rolling", 7.6e-3, _FOUND),
    Gap("collision_chain", "momentum", 5.4e-6, "velocities are differences of positions in single precision"),
    Gap("resting_weight", "force", 4.6e-3, _SUPPORT),
    Gap("resting_weight", "drift", 3.3e-5, _SUPPORT),
    Gap("stack", "weight", 0.076, _SUPPORT),
    Gap("grasp", "lift", 0.075, _FINGERS),
    Gap("grasp", "limit", 0.15, _FINGERS),
    Gap("contact_force_pairs", "net", 0.25, _SUPPORT),
    Gap("contact_force_pairs", "pairs", 0.38, _SUPPORT),
    Gap("contact_force_with_friction", "force", 2.2e-3, _SUPPORT),
    Gap("contact_impulses", "net", 0.8, _REBOUND),
    Gap("contact_impulses", "pairs", 0.8, _REBOUND),
    Gap("landing_force", "force", 2e-5, "forces follow from positions in single precision"),
    Gap("imu_in_a_circle", "angular_velocity", 0.024, _SHARES),
    Gap("imu_in_a_circle", "acceleration", 0.059, _SHARES),
    Gap("frame_and_joint_sensors", "joint_position", 5.7e-3, _SHARES),
    Gap("frame_and_joint_sensors", "joint_velocity", 0.023, _SHARES),
    Gap("frame_and_joint_sensors", "position", 2.3e-3, _SHARES),
    Gap("frame_and_joint_sensors", "orientation", 2.9e-3, _SHARES),
    Gap("frame_and_joint_sensors", "velocity", 0.027, _SHARES),
    Gap("center_of_mass_per_environment", "sag", 0.043, _SHARES),
)
