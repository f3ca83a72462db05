"""Action terms whose command is a pose: what they share, and differential inverse kinematics."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import ClassVar

import torch
from torch import Tensor

from orbit_core.actions.base import CommandMode, JointTarget, MotionGenerator
from orbit_core.actions.embodiment import arm_joints_of, end_effector_of, joints_above
from orbit_core.actions.ik import (
    COMPONENTS,
    IkMethod,
    PoseCommand,
    PoseFollower,
    damped_least_squares,
    joint_delta,
    steadying,
)
from orbit_core.actions.term import ActionTerm
from orbit_core.interfaces import ConfigurationError, Robot
from orbit_core.scene import RobotSpec


@dataclass(frozen=True, kw_only=True)
class PoseTermConfig(ActionTerm):
    """Settings that terms share whose command is the pose of a frame, or its change.

    It is (x, y, z, rotation vector), scaled by ``position_scale`` and ``rotation_scale``.

    Relative: a displacement of the measured pose, in world axes. Starting from the measured pose, and not from the last
    one commanded, a command's meaning does not depend on earlier ones, and pushing on an obstacle winds nothing up. The
    price: under a steady load that the drives' stiffness holds only by deflection, zero commands let the hand creep.
    Gravity compensation takes the arm's own weight out of that load; a closed loop (a policy, an expert) corrects the
    rest. Absolute and integrated commands do not creep.

    Absolute: the pose in the robot's root frame, relative to the hand's pose at home, axes of the root: zero is home,
    and the reachable box is home plus or minus the scales.

    Integrated: a displacement of the pose last asked for, in world axes.
    """

    above_zero: ClassVar[tuple[str, ...]] = ("position_scale", "rotation_scale", "position_lead", "rotation_lead")
    unbounded: ClassVar[tuple[str, ...]] = ("position_lead", "rotation_lead")

    frame: str | None = None
    """The frame that moves; None takes the first end effector's. ``joints`` are by default the arm of the end effector
    with that frame, or of the first one."""
    mode: CommandMode = CommandMode.RELATIVE
    """Reference that a command counts from."""
    position_scale: float = 0.05
    """m"""
    rotation_scale: float = 0.2
    """rad"""
    position_lead: float = math.inf
    """m by which the pose asked for may lead the measured one, where commands are not relative."""
    rotation_lead: float = math.inf
    """rad"""

    def default_joints(self, spec: RobotSpec) -> Sequence[str]:
        frames = [effector.frame for effector in spec.end_effectors]
        return arm_joints_of(spec, self.frame if self.frame in frames else None)

    def components(self, spec: RobotSpec, name: str) -> tuple[str, ...]:
        return COMPONENTS

    @property
    def reference(self) -> str:
        if self.mode is CommandMode.ABSOLUTE:
            return "the robot's root frame, axes of the root, from the moving frame's pose at home"
        start = "measured pose" if self.mode is CommandMode.RELATIVE else "last pose asked for"
        return f"axes of the world, from the moving frame's {start}"

    def frame_of(self, robot: Robot) -> str:
        """The frame that moves.

        Raises:
            UnknownNameError: the robot has no such link or frame.
            ConfigurationError: no joint of the term moves it.
        """
        spec = robot.spec
        frame = self.frame or end_effector_of(spec).frame
        # Raises the error for a frame that does not exist.
        robot.frame_pose(frame)
        joints = [robot.joint_names[joint] for joint in self.joint_indices(spec, self.name)]
        if joints_above(spec, frame).isdisjoint(joints):
            raise ConfigurationError(
                f"action term '{self.name}' moves {', '.join(joints)} of robot '{spec.name}', none of which moves "
                f"'{frame}': name joints between the root and it, or the frame that they move"
            )
        return frame

    def pose_command(self, robot: Robot) -> PoseCommand:
        """Return the meaning of commands."""
        scales, leads = (self.position_scale, self.rotation_scale), (self.position_lead, self.rotation_lead)
        return PoseCommand(robot, self.frame_of(robot), self.mode, scales, leads)


@dataclass(frozen=True, kw_only=True)
class DifferentialIkConfig(PoseTermConfig):
    """A command is a pose of the hand, or its change, which the joints follow.

    See :class:`PoseTermConfig` for what it counts from.
    """

    name: ClassVar[str] = "differential_ik"
    above_zero: ClassVar[tuple[str, ...]] = (*PoseTermConfig.above_zero, "max_joint_step")
    none_below_zero: ClassVar[tuple[str, ...]] = ("damping",)
    unbounded: ClassVar[tuple[str, ...]] = (*PoseTermConfig.unbounded, "max_joint_step")

    method: IkMethod = IkMethod.DAMPED_LEAST_SQUARES
    """Inversion of the Jacobian; damped least squares stays bounded everywhere."""
    damping: float = 0.05
    """See :func:`orbit_core.actions.ik.joint_delta`."""
    max_joint_step: float = 0.3
    """rad or m by which targets may run ahead of measured positions; larger steps are scaled down as a whole."""

    def build(self, name: str, robot: Robot) -> DifferentialIk:
        return DifferentialIk(name, robot, self)


class DifferentialIk(PoseFollower):
    """Six commands, :class:`DifferentialIkConfig`. Targets are clipped to the joints' limits."""

    def __init__(self, name: str, robot: Robot, config: DifferentialIkConfig) -> None:
        super().__init__(name, robot, config.joint_indices(robot.spec, name), 6, (JointTarget.POSITION,))
        self.config = config
        """Settings, as the action term gives them."""
        self.frame = config.frame_of(robot)
        """Name of the frame that moves."""
        self._pose = config.pose_command(robot)
        damped = config.method is IkMethod.DAMPED_LEAST_SQUARES
        self.bounded = damped and config.damping > 0.0  # other inverses are not finite where the Jacobian is singular
        self._settles = damped and config.mode is not CommandMode.RELATIVE

    def compute(self, inputs: Mapping[str, Tensor]) -> Mapping[str, Tensor]:
        displacement = self._pose.displacement(inputs["command"])
        jacobian = self.robot.jacobian(self.frame, self.joints)
        # Only goals that stay can make a stretched arm swing; relative commands move with the hand.
        if self._settles:
            delta = damped_least_squares(jacobian, displacement, self.config.damping, steadying(displacement))
        else:
            delta = joint_delta(self.config.method, jacobian, displacement, self.config.damping)
        return {JointTarget.POSITION: bounded_targets(self, delta, self.config.max_joint_step)}

    def encode(self, pose: Tensor, gripper_open: Tensor) -> Tensor:
        return self._pose.encode(pose)

    def reset(self, env_ids: Tensor | None = None) -> None:
        self._pose.reset(env_ids)

    def memory(self) -> Mapping[str, Tensor]:
        return self._pose.memory()


def bounded_targets(generator: MotionGenerator, delta: Tensor, max_joint_step: float) -> Tensor:
    """(N, k) positions that lie ``delta`` (N, k) from the measured ones, as a whole no further than ``max_joint_step``.

    They are clipped to the joints' limits.
    """
    # Scaled as a whole, so that the hand keeps its direction.
    largest = torch.linalg.vector_norm(delta, math.inf, dim=-1, keepdim=True)
    shrink = (largest.reciprocal() * max_joint_step).clamp(max=1.0)
    targets = torch.addcmul(generator.positions, delta, shrink)
    return torch.clamp(targets, generator.lower_limits, generator.upper_limits)
