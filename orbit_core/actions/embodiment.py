"""Defaults of action terms that a robot's description gives."""

from __future__ import annotations

import re
from collections.abc import Sequence

from orbit_core.interfaces import ConfigurationError, UnknownNameError, match_names
from orbit_core.scene import EndEffector, JointCommands, RobotSpec

# rad from home for one unit of action
_ARM_SCALE, _LEG_SCALE = 2.0, 0.5


def driven_joints(spec: RobotSpec) -> list[int]:
    """Indices of the joints that have an actuator and follow no other joint."""
    articulation = spec.articulation
    patterns = [pattern for group in spec.actuators for pattern in group.joints]
    joints = match_names(patterns, articulation.joint_names, "joint", f"'{spec.name}'")
    return [joint for joint in joints if articulation.movable_joints[joint].mimic is None]


# A robot's description decides scales, so that one task runs with robots of different sizes.
def joint_commands(spec: RobotSpec) -> JointCommands:
    """The robot's own, or else what its parts suggest.

    A robot that is there for its end effector is moved by the first one's arm, 2 rad from home either way and no faster
    than its joints may turn, as its own controller would see to. Another moves all driven joints but those of its
    base: a walker by 0.5 rad, others, such as hands without an arm, over the joints' limits.
    """
    if spec.joint_commands is not None:
        return spec.joint_commands
    if spec.has_arm and not spec.feet:
        return JointCommands(joints=spec.end_effector.arm_joints, position_scale=_ARM_SCALE, limit_speed=True)
    carrying = base_joints(spec)
    names = [spec.articulation.joint_names[joint] for joint in driven_joints(spec)]
    joints = tuple(re.escape(name) for name in names if name not in carrying)
    return JointCommands(joints=joints, position_scale=_LEG_SCALE if spec.feet else None)


def base_joints(spec: RobotSpec) -> tuple[str, ...]:
    """The joints that carry the robot: x, y and yaw of a planar base, left and right wheel of a differential one."""
    if spec.planar_base is not None:
        return (spec.planar_base.x, spec.planar_base.y, spec.planar_base.yaw)
    if spec.differential_base is not None:
        return (spec.differential_base.left, spec.differential_base.right)
    return ()


def leg_joints(spec: RobotSpec) -> tuple[str, ...]:
    """Patterns of the driven joints between a walking robot's root and its feet."""
    articulation = spec.articulation
    found = {name for foot in spec.feet for name in joints_above(spec, foot)}
    names = (articulation.joint_names[joint] for joint in driven_joints(spec))
    return tuple(re.escape(name) for name in names if name in found)


def joints_above(spec: RobotSpec, frame: str) -> set[str]:
    """Names of the joints between the robot's root and a link or frame: those that move it."""
    articulation = spec.articulation
    above = {joint.child: joint for joint in articulation.joints}
    link = frame if frame in articulation.link_names else articulation.frame(frame).link
    found: set[str] = set()
    while link in above:
        found.add(above[link].name)
        link = above[link].parent
    return found


def arm_joints_of(spec: RobotSpec, frame: str | None = None) -> tuple[str, ...]:
    """Patterns of the joints that move the end effector with that frame, or the first one.

    Raises:
        ConfigurationError: the robot has no end effector, or no arm moves it.
        UnknownNameError: no end effector has that frame.
    """
    effector = end_effector_of(spec, frame)
    if not effector.arm_joints:
        raise ConfigurationError(
            f"robot '{spec.name}' has no arm that moves its end effector: mount it on one, as in 'ur10+robotiq_2f85', "
            "or choose an action space of its joints"
        )
    return effector.arm_joints


def end_effector_of(spec: RobotSpec, frame: str | None = None) -> EndEffector:
    """The robot's end effector with that frame, or the first one.

    Raises:
        ConfigurationError: the robot has none.
        UnknownNameError: none of them has that frame.
    """
    if not spec.end_effectors:
        raise ConfigurationError(f"robot '{spec.name}' has no end effector: choose an action space of its joints")
    if frame is None:
        return spec.end_effector
    by_frame = {effector.frame: effector for effector in spec.end_effectors}
    if frame not in by_frame:
        raise UnknownNameError("end effector", frame, by_frame, f"robot '{spec.name}'")
    return by_frame[frame]


def end_effector_moved_by(spec: RobotSpec, joints: Sequence[int]) -> EndEffector:
    """The first end effector whose arm has one of these joints, or the robot's first one.

    Raises:
        ConfigurationError: the robot has none.
    """
    if len(spec.end_effectors) > 1:
        for effector in spec.end_effectors:
            arm = match_names(effector.arm_joints, spec.articulation.joint_names, "joint", f"'{spec.name}'")
            if not {*arm}.isdisjoint(joints):
                return effector
    return end_effector_of(spec)
