"""One command opens or closes a gripper."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import torch
from torch import Tensor

from orbit_core.interfaces import ConfigurationError, Robot
from orbit_core.motion.base import JointTarget, MotionGenerator, end_effector_of
from orbit_core.scene import Gripper


@dataclass(frozen=True, kw_only=True)
class GripperConfig:
    """A negative command closes the gripper, any other opens it."""

    gripper: Gripper | None = None
    """None takes the one of the robot's end effector."""


class GripperCommand(MotionGenerator):
    """One command for all joints of a gripper, :class:`GripperConfig`."""

    def __init__(self, name: str, robot: Robot, config: GripperConfig) -> None:
        gripper = config.gripper or end_effector_of(robot).gripper
        if gripper is None:
            raise ConfigurationError(f"the end effector of robot '{robot.name}' has no gripper: give the gripper")
        joints = robot.find_joints(*gripper.joints)
        super().__init__(name, robot, joints, 1, (JointTarget.POSITION,))
        self._open = torch.full((len(joints),), gripper.open_position, device=self.device)
        self._closed = torch.full((len(joints),), gripper.closed_position, device=self.device)

    def compute(self, inputs: Mapping[str, Tensor]) -> Mapping[str, Tensor]:
        return {JointTarget.POSITION.value: torch.where(inputs["command"] < 0.0, self._closed, self._open)}

    def encode(self, pose: Tensor, gripper_open: Tensor) -> Tensor:
        return (2.0 * gripper_open.to(torch.float32) - 1.0).unsqueeze(-1)
