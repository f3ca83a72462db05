"""Observations of walking robots' policies, and the drives that they learn with."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any

import torch
from torch import Tensor

from orbit_core.actions import joint_commands
from orbit_core.actions.embodiment import leg_joints
from orbit_core.dynamics.constants import constant
from orbit_core.dynamics.transforms import quat_rotate_inverse, yaw_angle
from orbit_core.envs import Environment
from orbit_core.envs.state import TaskState
from orbit_core.interfaces import Robot, World, match_names
from orbit_core.interfaces.layout import joint_limits
from orbit_core.mdp import common
from orbit_core.scene import ActuatorConfig, RobotSpec
from orbit_motion import workspace as task_robots

# rad from home for one unit of action. On one leg a robot's weight takes targets far beyond where the leg goes.
_BIPED_SCALE = 1.0
# rad
_ARM_SPREAD = 0.5
# Of joint velocities in observations.
JOINT_SPEED_SCALE = 0.05
COMMAND = "command"
LAST_ACTION = "last_action"


def walker(name: str, scale: float | None) -> RobotSpec:
    """A robot of the catalogue with feet, as the task's robot, with the drives that it learns to walk with.

    Args:
        name: of the robot.
        scale: rad from home for one unit of action ``joint_position``; None leaves what the robot says, 0.5 for most,
            and takes 1 on two feet.

    Raises:
        UnknownNameError, ConfigurationError: as :func:`orbit_motion.workspace.legged`; or the scale is not above
            zero.
    """
    spec = task_robots.legged(name)
    if carries_arm(spec):
        # The legs alone act, by the commands of a robot without the arm.
        legs = replace(joint_commands(replace(spec, end_effectors=())), joints=leg_joints(spec))
        idle = tuple(replace(effector, gripper=None) for effector in spec.end_effectors)
        spec = replace(spec, joint_commands=legs, end_effectors=idle)
    if scale is None and len(spec.feet) <= 2:
        scale = _BIPED_SCALE
    if scale is not None:
        spec = scaled(spec, scale)
    return replace(spec, actuators=(*_others(spec), *spec.walking_drives)) if spec.walking_drives else spec


def scaled(spec: RobotSpec, scale: float) -> RobotSpec:
    """The robot with so many rad from home for one unit of action ``joint_position``."""
    return replace(spec, joint_commands=replace(joint_commands(spec), position_scale=scale))


def carries_arm(spec: RobotSpec) -> bool:
    """Return True if a robot on more than two feet has an arm, which it only carries: a biped's swing."""
    return spec.has_arm and len(spec.feet) > 2


def carry_anyhow(world: World, env_ids: Tensor) -> None:
    """Put an arm that the robot carries anywhere within :data:`_ARM_SPREAD` of its home, where its drives hold it."""
    robot = common.robot_of(world)
    if not carries_arm(robot.spec):
        return
    joints = robot.find_joints(*robot.spec.end_effector.arm_joints)
    home, limits = robot.home_positions[joints], robot.position_limits[joints]
    offset = world.random.uniform((len(joints),), -_ARM_SPREAD, _ARM_SPREAD, env_ids)
    robot.set_joint_state((home + offset).clamp(limits[:, 0], limits[:, 1]), joints=joints, env_ids=env_ids)


def _others(spec: RobotSpec) -> list[ActuatorConfig]:
    """The robot's actuators without the joints of its walking drives."""
    names, where = spec.articulation.joint_names, f"an actuator group of '{spec.name}'"
    taken = match_names([joint for drive in spec.walking_drives for joint in drive.joints], names, "joint", where)
    kept = [
        (group, [names[i] for i in match_names(group.joints, names, "joint", where) if i not in taken])
        for group in spec.actuators
    ]
    return [replace(group, joints=tuple(re.escape(name) for name in left)) for group, left in kept if left]


DOWN = (0.0, 0.0, -1.0)
"""Direction of gravity."""


def linear_velocity(robot: Robot) -> Tensor:
    """(N, 3) of the trunk, in its own axes."""
    return quat_rotate_inverse(robot.root_pose[:, 3:], robot.root_velocity[:, :3])


def angular_velocity(robot: Robot) -> Tensor:
    """(N, 3) of the trunk, in its own axes."""
    return quat_rotate_inverse(robot.root_pose[:, 3:], robot.root_velocity[:, 3:])


def projected_gravity(robot: Robot) -> Tensor:
    """(N, 3) the direction of gravity in the trunk's axes; (0, 0, -1) when level."""
    return quat_rotate_inverse(robot.root_pose[:, 3:], constant(DOWN, robot.root_pose.device))


def trunk_motion(robot: Robot) -> Tensor:
    """Compute what the trunk feels, in its own axes.

    Returns:
        (N, 3, 3): linear velocity in m/s, angular velocity in rad/s, and the direction of gravity, turned together.
    """
    pose = robot.root_pose
    down = constant(DOWN, pose.device).expand(pose.shape[0], 1, 3)
    vectors = torch.cat((robot.root_velocity.view(-1, 2, 3), down), 1)
    return quat_rotate_inverse(pose[:, None, 3:], vectors)


def heading(robot: Robot) -> Tensor:
    """(N,) rad: the direction that the trunk faces, about the vertical."""
    return yaw_angle(robot.root_pose[:, 3:])


# By the names that observations give them, except :data:`COMMAND` and :data:`LAST_ACTION`.
READINGS: Mapping[str, Callable[[Robot], Tensor]] = {
    "linear_velocity": linear_velocity,
    "angular_velocity": angular_velocity,
    "projected_gravity": projected_gravity,
    "joint_positions": lambda robot: robot.joint_positions - robot.home_positions,
    "joint_velocities": lambda robot: JOINT_SPEED_SCALE * robot.joint_velocities,
}

# Those with a component for each joint.
JOINT_READINGS = ("joint_positions", "joint_velocities")


class SpeedLimited(TaskState):
    """State of a task whose joints :func:`overspeed` judges."""

    speed_limits: Tensor
    """(joints,) rad/s."""

    def start(self, env: Environment) -> None:
        self.speed_limits = speed_limits(common.robot_of(env.world))


def speed_limits(robot: Robot) -> Tensor:
    """(joints,) rad/s that the robot's description allows its joints."""
    limits = joint_limits(robot.spec, "velocity_limit")
    return torch.as_tensor(limits, dtype=torch.float32, device=robot.home_positions.device)


def overspeed(env: Environment[Any, SpeedLimited]) -> Tensor:
    """(N,) rad/s, summed over joints: what they are beyond their velocity limits, which few engines hold."""
    speeds = common.robot_of(env.world).joint_velocities.abs()
    return (speeds - env.state.speed_limits).clamp_min(0.0).sum(1)
