"""Action spaces by name: the tail of the agent's graph, from the policy's action to joint targets."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Mapping
from dataclasses import replace

from orbit_core.interfaces import Robot, UnknownNameError, match_names
from orbit_core.motion.base import MotionGenerator, commanded_joints, is_arm
from orbit_core.motion.differential_ik import DifferentialIk, DifferentialIkConfig
from orbit_core.motion.gripper import GripperCommand, GripperConfig
from orbit_core.motion.joint_effort import JointEffort, JointEffortConfig
from orbit_core.motion.joint_position import JointPosition, JointPositionConfig
from orbit_core.motion.joint_velocity import JointVelocity, JointVelocityConfig
from orbit_core.scene import ActuatorConfig, RobotSpec


def action_space(robot: Robot, name: str, prefix: str = "") -> tuple[MotionGenerator, ...]:
    """The motion generators of an action space, in the order of the action's components.

    The first moves the arm of the robot's end effector, or all driven joints where the robot is legged or has none; the
    gripper of an arm adds one more. In ``joint_position``, one unit of action is half a radian from home for legs and
    two for an arm; other robots, such as hands, span their joints' limits. An arm's position targets lead its joints by
    no more than their velocity limits allow, as its own controller would see to. ``prefix`` begins the generators'
    names, so that those of several robots fit into one agent.

    Raises:
        UnknownNameError: there is no action space of that name.
        ConfigurationError: the robot has no end effector, and the space needs one.
    """
    if name not in ACTION_SPACES:
        raise UnknownNameError("action space", name, ACTION_SPACES)
    generators = [ACTION_SPACES[name](robot)]
    if is_arm(robot.spec) and robot.spec.end_effector.gripper:
        generators.append(GripperCommand("gripper", robot, GripperConfig()))
    for generator in generators:
        generator.name = prefix + generator.name
    return tuple(generators)


def with_drives_for(spec: RobotSpec, name: str) -> RobotSpec:
    """The robot with drives that suit an action space.

    For ``joint_velocity`` the commanded joints' drives lose their stiffness, for ``joint_effort`` their damping too, so
    that nothing works against the command. Other spaces, and other joints, keep the drives as they are.
    """
    if name not in _WITHOUT:
        return spec
    names = spec.articulation.joint_names
    commanded = {names[joint] for joint in commanded_joints(spec)}
    groups: list[ActuatorConfig] = []
    for group in spec.actuators:
        matched = [names[j] for j in match_names(group.joints, names, "joint", f"'{spec.name}'")]
        changed = tuple(re.escape(joint) for joint in matched if joint in commanded)
        kept = tuple(re.escape(joint) for joint in matched if joint not in commanded)
        if changed:
            groups.append(replace(group, joints=changed, **_WITHOUT[name]))
        if kept:
            groups.append(replace(group, joints=kept))
    return replace(spec, actuators=tuple(groups))


_WITHOUT: Mapping[str, Mapping[str, float]] = {
    "joint_velocity": {"stiffness": 0.0},
    "joint_effort": {"stiffness": 0.0, "damping": 0.0},
}


def _joint_position(robot: Robot) -> MotionGenerator:
    scale = 2.0 if is_arm(robot.spec) else 0.5 if robot.spec.feet else None
    config = JointPositionConfig(scale=scale, limit_speed=is_arm(robot.spec))
    return JointPosition("joint_position", robot, config)


def _joint_position_relative(robot: Robot) -> MotionGenerator:
    config = JointPositionConfig(scale=0.05, relative=True, limit_speed=is_arm(robot.spec))
    return JointPosition("joint_position_relative", robot, config)


def _joint_velocity(robot: Robot) -> MotionGenerator:
    return JointVelocity("joint_velocity", robot, JointVelocityConfig())


def _joint_effort(robot: Robot) -> MotionGenerator:
    return JointEffort("joint_effort", robot, JointEffortConfig())


def _ik_absolute(robot: Robot) -> MotionGenerator:
    config = DifferentialIkConfig(relative=False, position_scale=0.5, rotation_scale=math.pi)
    return DifferentialIk("ik_absolute", robot, config)


def _ik_relative(robot: Robot) -> MotionGenerator:
    return DifferentialIk("ik_relative", robot, DifferentialIkConfig())


ACTION_SPACES: Mapping[str, Callable[[Robot], MotionGenerator]] = {
    "joint_position": _joint_position,
    "joint_position_relative": _joint_position_relative,
    "joint_velocity": _joint_velocity,
    "joint_effort": _joint_effort,
    "ik_absolute": _ik_absolute,
    "ik_relative": _ik_relative,
}
