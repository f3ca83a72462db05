"""Commands are poses of the end effector, or changes of its pose, followed by differential inverse kinematics."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import ClassVar

import torch
from torch import Tensor

from orbit_core.dynamics.kinematics import KinematicTree
from orbit_core.dynamics.transforms import (
    pose_error,
    pose_inverse,
    pose_multiply,
    quat_from_rotation_vector,
    quat_multiply,
)
from orbit_core.interfaces import Robot
from orbit_core.motion.base import JointTarget, MotionGenerator
from orbit_core.motion.embodiment import arm_joints_of, end_effector_of
from orbit_core.motion.ik import IkMethod, joint_delta
from orbit_core.motion.term import ActionTerm
from orbit_core.scene import RobotSpec


@dataclass(frozen=True, kw_only=True)
class DifferentialIkConfig(ActionTerm):
    """A command is a pose of the hand, or its change, which the joints follow.

    It is (x, y, z, rotation vector), scaled by ``position_scale`` and ``rotation_scale``.

    Relative: a displacement of the measured pose, in world axes. Starting from the measured pose, and not from the last
    one commanded, a command means the same whatever came before, and pushing against an obstacle winds nothing up. The
    price: under a steady load that the drives' stiffness holds only by deflection, zero commands let the hand creep.
    Gravity compensation takes the arm's own weight out of that load; a closed loop (a policy, an expert) corrects the
    rest. Absolute commands do not creep.

    Absolute: the pose in the robot's root frame, relative to the hand's pose at home, axes of the root: zero is home,
    and the reachable box is home plus or minus the scales.
    """

    name: ClassVar[str] = "differential_ik"

    frame: str | None = None
    """The frame that moves; None takes the first end effector's. ``joints`` are by default the arm of the end effector
    with that frame, or of the first one."""
    method: IkMethod = IkMethod.DAMPED_LEAST_SQUARES
    relative: bool = True
    position_scale: float = 0.05
    """m"""
    rotation_scale: float = 0.2
    """rad"""
    damping: float = 0.05
    """See :func:`orbit_core.motion.ik.joint_delta`."""
    max_joint_step: float = 0.3
    """rad or m by which targets may run ahead of measured positions; larger steps are scaled down as a whole."""

    def default_joints(self, spec: RobotSpec) -> Sequence[str]:
        frames = [effector.frame for effector in spec.end_effectors]
        return arm_joints_of(spec, self.frame if self.frame in frames else None)

    def components(self, spec: RobotSpec, name: str) -> tuple[str, ...]:
        return ("x", "y", "z", "about x", "about y", "about z")

    def build(self, name: str, robot: Robot) -> DifferentialIk:
        return DifferentialIk(name, robot, self)


class DifferentialIk(MotionGenerator):
    """Six commands, :class:`DifferentialIkConfig`. Targets are clipped to the joints' limits."""

    def __init__(self, name: str, robot: Robot, config: DifferentialIkConfig) -> None:
        super().__init__(name, robot, config.joint_indices(robot.spec, name), 6, (JointTarget.POSITION,))
        self.config = config
        self.frame = config.frame or end_effector_of(robot.spec).frame
        self._scale = torch.tensor([config.position_scale] * 3 + [config.rotation_scale] * 3, device=self.device)
        self._home = _pose_at_home(robot, self.frame)

    def compute(self, inputs: Mapping[str, Tensor]) -> Mapping[str, Tensor]:
        displacement = inputs["command"] * self._scale
        if not self.config.relative:
            displacement = pose_error(self.robot.frame_pose(self.frame), self._absolute(displacement))
        jacobian = self.robot.jacobian(self.frame, self.joints)
        delta = joint_delta(self.config.method, jacobian, displacement, self.config.damping)
        largest = torch.linalg.vector_norm(delta, math.inf, dim=-1, keepdim=True)
        shrink = (self.config.max_joint_step / largest).clamp(max=1.0)
        targets = torch.addcmul(self.positions, delta, shrink)
        return {JointTarget.POSITION.value: torch.clamp(targets, self.lower_limits, self.upper_limits)}

    def encode(self, pose: Tensor, gripper_open: Tensor) -> Tensor:
        if self.config.relative:
            command = pose_error(self.robot.frame_pose(self.frame), pose) / self._scale
            parts = command.unflatten(-1, (2, 3))
            # Position and rotation each keep their direction where they are too far for one command.
            return (parts / parts.abs().amax(-1, keepdim=True).clamp_min(1.0)).flatten(-2)
        local = pose_multiply(pose_inverse(self.robot.root_pose), pose)
        return (pose_error(self._home, local) / self._scale).clamp(-1.0, 1.0)

    def _absolute(self, displacement: Tensor) -> Tensor:
        """(N, 7) the pose wanted, in the environment's frame."""
        rotation = quat_multiply(quat_from_rotation_vector(displacement[:, 3:]), self._home[3:])
        local = torch.cat((self._home[:3] + displacement[:, :3], rotation), -1)
        return pose_multiply(self.robot.root_pose, local)


def _pose_at_home(robot: Robot, frame: str) -> Tensor:
    """(7,) of the frame in the robot's root frame, with the joints at home."""
    tree = KinematicTree(robot.spec.articulation, robot.home_positions.device)
    root = torch.tensor([[0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0]], device=tree.device)
    return tree.frame_pose(tree.forward(root, robot.home_positions[None]), frame)[0]
