"""What a walking robot's policy is shown of the robot itself."""

from __future__ import annotations

from collections.abc import Callable, Mapping

import torch
from torch import Tensor

from orbit_core.dynamics.transforms import quat_rotate_inverse, yaw_angle
from orbit_core.interfaces import Robot

JOINT_SPEED_SCALE = 0.05
"""Of joint velocities in observations."""
COMMAND = "command"
LAST_ACTION = "last_action"


def linear_velocity(robot: Robot) -> Tensor:
    """(N, 3) of the trunk, in its own axes."""
    return quat_rotate_inverse(robot.root_pose[:, 3:], robot.root_velocity[:, :3])


def angular_velocity(robot: Robot) -> Tensor:
    """(N, 3) of the trunk, in its own axes."""
    return quat_rotate_inverse(robot.root_pose[:, 3:], robot.root_velocity[:, 3:])


def projected_gravity(robot: Robot) -> Tensor:
    """(N, 3) the direction of gravity in the trunk's axes; (0, 0, -1) when level."""
    pose = robot.root_pose
    down = torch.zeros_like(pose[:, :3])
    down[:, 2] = -1.0
    return quat_rotate_inverse(pose[:, 3:], down)


def heading(robot: Robot) -> Tensor:
    """(N,) rad: the direction that the trunk faces, about the vertical."""
    return yaw_angle(robot.root_pose[:, 3:])


READINGS: Mapping[str, Callable[[Robot], Tensor]] = {
    "linear_velocity": linear_velocity,
    "angular_velocity": angular_velocity,
    "projected_gravity": projected_gravity,
    "joint_positions": lambda robot: robot.joint_positions - robot.home_positions,
    "joint_velocities": lambda robot: JOINT_SPEED_SCALE * robot.joint_velocities,
}
"""By the names that observations give them, besides :data:`COMMAND` and :data:`LAST_ACTION`."""

JOINT_READINGS = ("joint_positions", "joint_velocities")
"""Those with a component for each joint."""
