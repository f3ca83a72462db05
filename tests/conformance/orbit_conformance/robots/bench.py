"""Test bench of a robot: its placement, and the joints that are moved there."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import numpy.typing as npt

from orbit_core.interfaces import match_names
from orbit_core.scene import Joint, JointType, RobotSpec

FloatArray = npt.NDArray[np.float64]
# Radians to either side of zero, for joints without limits.
_TURN = math.pi


def clamped(spec: RobotSpec) -> RobotSpec:
    """The robot with its root held, and links that do not collide with each other."""
    return replace(spec, fixed_base=True, articulation=replace(spec.articulation, self_collisions=False))


def frictionless(spec: RobotSpec) -> RobotSpec:
    """The robot without Coulomb friction in its joints, which no linear law describes."""
    joints = tuple(replace(joint, friction=0.0) for joint in spec.articulation.joints)
    groups = tuple(replace(group, friction=None) for group in spec.actuators)
    return replace(spec, articulation=replace(spec.articulation, joints=joints), actuators=groups)


def travel(joint: Joint) -> tuple[float, float]:
    """The limits of a joint, in rad or m; half a turn, or as many metres, where it has none."""
    if joint.type is JointType.CONTINUOUS:
        return -_TURN, _TURN
    low, high = joint.lower_limit, joint.upper_limit
    return (low if math.isfinite(low) else -_TURN), (high if math.isfinite(high) else _TURN)


def drive_gains(spec: RobotSpec) -> tuple[FloatArray, FloatArray]:
    """Return stiffness and damping (J,) of the joints' drives, the engine's or ORBIT's; zero where there is none."""
    gains = np.zeros((2, len(spec.articulation.joint_names)))
    for group in spec.actuators:
        joints = match_names(group.joints, spec.articulation.joint_names, "joint", f"'{spec.name}'")
        gains[:, joints] = [[group.stiffness], [group.damping]]
    return gains[0], gains[1]


def held_joints(spec: RobotSpec) -> list[int]:
    """Indices of the joints that a drive with stiffness holds in place."""
    stiffness, _ = drive_gains(spec)
    joints = enumerate(spec.articulation.movable_joints)
    return [index for index, joint in joints if joint.mimic is None and stiffness[index] > 0.0]
