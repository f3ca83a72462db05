"""Where joints should go next to bring the end effector nearer to a pose: the expert's way into joint spaces."""

from __future__ import annotations

from torch import Tensor

from orbit_core.dynamics.transforms import pose_error
from orbit_core.interfaces import Robot
from orbit_core.motion.base import end_effector_of
from orbit_core.motion.ik import damped_least_squares

DAMPING = 0.05


def towards_pose(robot: Robot, joints: list[int], pose: Tensor) -> Tensor:
    """Displacement (N, k) of ``joints`` by one damped least-squares step from the measured state to ``pose`` (N, 7).

    Raises:
        ConfigurationError: the robot has no end effector.
    """
    frame = end_effector_of(robot).frame
    error = pose_error(robot.frame_pose(frame), pose)
    return damped_least_squares(robot.jacobian(frame, joints), error, DAMPING)
