"""The metrics of the conformance scenarios that MuJoCo's equations miss on any device, with limits and reasons."""

from __future__ import annotations

from orbit_core.interfaces import Gap

_ORIGIN = (
    "a free body's velocity is that of its origin and integrated in first order: a centre of mass aside leaves its "
    "path; integrator 'rk4' keeps it, where there is"
)
_GYROSCOPIC = "gyroscopic torques are taken at the beginning of the step, so that free bodies gain energy"
_REDUCED = (
    "joint velocities are integrated in first order, and the momenta that they add up to are then conserved in first "
    "order only; integrator 'rk4' keeps them to 2e-5"
)
_DRIVEN = (
    "constraints are solved without the drives' damping, which integrator 'implicitfast' adds afterwards: when a stiff "
    "drive starts, what is coupled to its joint falls behind for a moment; integrator 'discrete' mends it, and damps "
    "the motion of soft drives three times as much"
)
_EARLY_SPRING = (
    "a drive's spring is taken at the beginning of the step and its damping at the end: its motion is first order in "
    "the step"
)
_HELD = (
    "a weakly damped drive of more than one radian of natural frequency per step is damped further, to be stable, and "
    "passes its target once: at 2.5 radians by 0.16 of the way"
)
_SINKING = "contacts give way: the boxes of a thread sink into each other by some 0.2 mm, an edge at a time"
_UNDAMPED = (
    "joint velocities are integrated in first order, which takes energy from fast chains and gives it to slow ones; "
    "integrator 'rk4' keeps it to 1.2 % over 20 s, and to 4 % in single precision"
)

_SOFT_STOP = (
    "limits are springs and dampers of 20 ms, on which learned gaits depend: a joint of 20 rad/s passes by 0.157 rad "
    "in any step; with limit_solref=(0.01, 2.0) by the way of one step of 5 ms, 0.1 rad, and it returns at a sixteenth "
    "of its speed in the place of a sixth"
)

_SWITCHED = (
    "a drive at its limit is applied without its damping, and swings by limit * h / inertia about a target that it "
    "does not meet by chance: armature, a smaller step or less damping than twice the inertia over a step end it"
)
_STRUCK = (
    "a drive is held to its limit by the effort that a step begins with: what strikes it meets its whole damping for "
    "one step, 0.084 of the speed after ten steps"
)

MOTION = (
    Gap("effort_limits", "settling", 0.13, _SWITCHED),
    Gap("effort_limits", "struck", 0.1, _STRUCK),
    Gap("joint_stops", "passed", 0.17, _SOFT_STOP),
    Gap("joint_stops", "rebound", 0.17, _SOFT_STOP),
    Gap("projectile", "range", 7e-3, _ORIGIN),
    Gap("spinning_bodies", "energy", 0.02, _GYROSCOPIC),
    Gap("spinning_bodies", "path", 0.012, _ORIGIN),
    Gap("floating_chain", "linear_momentum", 0.012, _REDUCED),
    Gap("floating_chain", "angular_momentum", 0.025, _REDUCED),
    Gap("floating_chain", "path", 6e-3, _REDUCED),
    Gap("floating_chain", "energy", 0.03, _REDUCED),
    Gap("mimic_joints", "driven", 0.3, _DRIVEN),
    Gap("four_bar_linkage", "rocker", 0.05, _DRIVEN),
    Gap("four_bar_linkage", "opening", 0.018, _DRIVEN),
    Gap("drive_frequencies", "response", 0.18, _EARLY_SPRING),
    Gap("drive_frequencies", "beyond", 0.25, _HELD),
    Gap("energy_of_a_chain", "gained", 0.5, _UNDAMPED),
    Gap("energy_of_a_chain", "lost", 1.0, _UNDAMPED),
)
"""Gaps of free motion and joints."""

CREEP = (
    "friction is a soft constraint, whose force grows with the speed of creep; impratio=10 makes that 16 times slower, "
    "for up to a quarter more time per step"
)
_HOP = (
    "the convex friction cone pushes what slides off the surface, so that it hops; the less, the shorter the contact's "
    "time constant and the step"
)
_ONE_COEFFICIENT = "there is one coefficient of sliding friction, the dynamic one"
_SLIDING_IMPACT = (
    "the convex friction cone adds to a rebound what friction could not remove of the slip, times the coefficient: a "
    "flat box at 1.5 times its landing speed rebounds at 0.28 in place of 0, and at 0.16 more than asked"
)
_SUNK = (
    "an impact is met in the step after the two have touched, or by a soft contact where there is no restitution: what "
    "has sunk in has a shorter arm, and friction stops more or less than its slip"
)
_UNEVEN = (
    "soft contacts share the load of what slides unevenly between its feet: a prism on its six corners turns by 24 "
    "degrees in 0.7 s, a tripod by 10, a box by 4"
)
_EDGES = (
    "each triangle is collided with its sides, against which a ball runs that sinks in by tenths of a millimetre: in a "
    "bowl of facets of 50 mm it loses 0.18 of its amplitude in a period"
)
_SOFT = (
    "contacts are springs of 20 ms, which give way: by 0.15 mm under a cube of 1 kg, and by 2.7 mm a layer in a tower "
    "under 100 kg; a shorter time constant or a greater impedance makes them stiffer"
)
_LEANING = (
    "contacts are springs of 20 ms: the lower edges give way, so that a tower leans further than its slope; blocks of "
    "0.1 m topple 5 % early, and 2 % where they are 0.5 m or the time constant is 10 ms"
)
_TORSION = (
    "friction is a soft constraint, and what turns meets a damper that is the softer, the smaller the coefficient of "
    "torsional friction; with impratio=10 a gripped box turns seven times slower, for up to a quarter more time a step"
)

_HANDS = (
    "allegro_left", "allegro_right", "dex3_left", "dex3_right", "shadow_hand",
    "franka_panda_allegro", "ur10_shadow_hand", "unitree_g1_dex3",
)  # fmt: skip
_FINGERS = f"what soft motors press with 10 to 20 N creeps by 3 to 6 mm/s under 4 N: {CREEP}"
_WALKERS = ("anymal_b", "anymal_c", "anymal_c_kinova_gen3", "unitree_go2")
_FEET = f"soft legs that stand apart push their feet outwards all the time, and these creep: {CREEP}"

CONTACT = (
    Gap("driven_wheels", "speed", 0.06, CREEP),
    Gap("driven_wheels", "pitch", 0.02, f"the trunk nods on its contacts: {_SOFT}"),
    Gap("screw", "lead", 0.12, _SINKING),
    Gap("screw", "pace", 0.15, _SINKING),
    Gap("stick_and_slip", "creep", 0.012, CREEP),
    Gap("stick_and_slip", "friction", 0.12, _HOP),
    Gap("stopping_distance", "distance", 0.09, _HOP),
    Gap("stopping_distance", "turn", 0.7, _UNEVEN),
    Gap("static_above_dynamic", "slip", 0.5, _ONE_COEFFICIENT),
    Gap("static_above_dynamic", "friction", 0.06, _HOP),
    Gap("torsional_friction", "deceleration", 0.01, _HOP),
    Gap("ball_on_slope", "slipping", 0.08, _HOP),
    Gap("sliding_to_rolling", "way", 0.1, _HOP),
    Gap("ball_on_turntable", "path", 0.09, f"{CREEP}, over which the table drags the ball along"),
    Gap("requested_torsional_friction", "ball", 0.1, _HOP),
    Gap("requested_torsional_friction", "box", 0.35, _HOP),
    Gap("requested_torsional_friction", "cylinder", 0.16, _HOP),
    Gap("torsional_grip", "creep", 4.0, _TORSION),
    Gap("torsional_grip", "turning", 2.0, _TORSION),
    Gap("pivot_in_a_grip", "slip", 3e-3, CREEP),
    Gap("loaded_tower", "sink_10", 1.2e-3, _SOFT),
    Gap("loaded_tower", "sink_100", 4.5e-3, _SOFT),
    Gap("toppling_tower", "tilt", 0.06, _LEANING),
    Gap("toppling_tower", "creep", 0.012, CREEP),
    Gap("jamming_peg", "insertion", 0.6, _HOP + ": 0.34 at 5 ms and 0.03 at 1.25 ms"),
    Gap("wedged_peg", "wedge", 0.25, f"a wedged peg turns by 0.05 rad until it is held: {CREEP}"),
    Gap("wedged_peg", "creep", 6e-4, CREEP),
    Gap("oblique_impact", "spin", 0.25, _SUNK),
    Gap("oblique_impact", "rolling", 0.4, _SUNK),
    Gap("oblique_impact", "rebound", 0.4, _SLIDING_IMPACT),
    Gap("mesh_bowl", "amplitude", 0.3, _EDGES),
    Gap("grasp", "limit", 0.08, f"{CREEP}; once it slips, {_HOP}"),
    Gap("stack", "penetration", 1.1e-3, _SOFT),
    Gap("robot_grasp", "slip", 0.017, _FINGERS, _HANDS),
    Gap("robot_stand", "height", 0.16, _FEET, ("anymal_b", "anymal_c", "anymal_c_kinova_gen3")),
    Gap("robot_stand", "joints", 0.07, _FEET, _WALKERS),
)
"""Gaps of contact."""
