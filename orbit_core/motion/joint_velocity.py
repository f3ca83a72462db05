"""Commands are joint velocities."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar

from torch import Tensor

from orbit_core.interfaces import Robot
from orbit_core.motion.base import JointTarget, MotionGenerator
from orbit_core.motion.ik import towards_pose
from orbit_core.motion.term import ActionTerm

_PURSUIT_RATE = 5.0
"""1/s: the velocity that an expert asks for, over the displacement that is left."""


@dataclass(frozen=True, kw_only=True)
class JointVelocityConfig(ActionTerm):
    """A command is the velocity of each joint.

    ``velocity target = scale * command``. The position target is put at the measured position at every turn, so that a
    drive with stiffness resists the motion only by as much as it moves between two turns; a drive meant for velocities
    has none.
    """

    name: ClassVar[str] = "joint_velocity"
    unwanted_gains: ClassVar[tuple[str, ...]] = ("stiffness",)

    scale: float = 1.0
    """rad/s or m/s."""

    def build(self, name: str, robot: Robot) -> JointVelocity:
        return JointVelocity(name, robot, self)


class JointVelocity(MotionGenerator):
    """One command a joint, :class:`JointVelocityConfig`."""

    def __init__(self, name: str, robot: Robot, config: JointVelocityConfig) -> None:
        joints = config.joint_indices(robot.spec, name)
        super().__init__(name, robot, joints, len(joints), (JointTarget.POSITION, JointTarget.VELOCITY))
        self.config = config

    def compute(self, inputs: Mapping[str, Tensor]) -> Mapping[str, Tensor]:
        return {
            JointTarget.POSITION.value: self.positions,
            JointTarget.VELOCITY.value: self.config.scale * inputs["command"],
        }

    def encode(self, pose: Tensor, gripper_open: Tensor) -> Tensor:
        velocities = _PURSUIT_RATE * towards_pose(self.robot, self.joints, pose)
        # Slowed down together, so that the hand keeps its direction.
        return velocities / velocities.abs().amax(-1, keepdim=True).clamp_min(self.config.scale)
