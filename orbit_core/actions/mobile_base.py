"""Commands of mobile bases: planar velocities, and those of two driven wheels."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import ClassVar

import torch
from torch import Tensor

from orbit_core.actions.base import JointTarget, MotionGenerator
from orbit_core.actions.ik import towards_pose
from orbit_core.actions.term import ActionTerm
from orbit_core.dynamics.indexing import write_rows
from orbit_core.dynamics.transforms import quat_rotate_inverse
from orbit_core.interfaces import ConfigurationError, Robot
from orbit_core.interfaces.layout import joint_limits
from orbit_core.scene import DifferentialBase, RobotSpec

PURSUIT_RATE = 2.0
"""1/s: the velocity that an expert asks for, over the displacement that is left."""
ROUNDING = 1e-5
"""Of a command that is meant to be at its limit."""


@dataclass(frozen=True, kw_only=True)
class BaseVelocityConfig(ActionTerm):
    """A command is the velocity of a mobile base: (forward, left, turn) in its own axes.

    It is over the limits below. ``joints`` are three names, of the joint along the root's x, of that along its y and of
    the yaw about its z; None takes the robot's :class:`~orbit_core.scene.PlanarBase`. As in
    :class:`JointVelocityConfig`, position targets are put at the measured positions at every turn.
    """

    name: ClassVar[str] = "base_velocity"
    above_zero: ClassVar[tuple[str, ...]] = ("max_speed", "max_yaw_rate")
    unwanted_gains: ClassVar[tuple[str, ...]] = ("stiffness",)

    max_speed: float = 1.0
    """m/s over the plane; a faster command is slowed down and keeps its direction."""
    max_yaw_rate: float = 1.0
    """rad/s."""

    @property
    def limits(self) -> tuple[float, float, float]:
        """Return the velocity of a command of 1: m/s forward, m/s to the left, rad/s."""
        return (self.max_speed, self.max_speed, self.max_yaw_rate)

    def default_joints(self, spec: RobotSpec) -> Sequence[str]:
        base = spec.planar_base
        if base is None:
            raise ConfigurationError(f"robot '{spec.name}' has no planar base: name the joints of its x, y and yaw")
        return (base.x, base.y, base.yaw)

    @property
    def reference(self) -> str:
        return "the base's own axes: x forward, y to the left, z up"

    def components(self, spec: RobotSpec, name: str) -> tuple[str, ...]:
        return ("forward", "left", "turn")

    def joint_indices(self, spec: RobotSpec, name: str) -> list[int]:
        """Indices of the joints of x, y and yaw, in this order."""
        joints = super().joint_indices(spec, name)
        # Regular expressions lose the order, and here it says which joint is x, y and yaw.
        names = list(self.default_joints(spec) if self.joints is None else self.joints)
        if sorted(names) != sorted(spec.articulation.joint_names[joint] for joint in joints) or len(names) != 3:
            raise ConfigurationError(
                f"action term '{name}' moves a base by exactly three joints, by name: x, y and yaw; not {names}"
            )
        return [spec.articulation.joint_names.index(joint) for joint in names]

    def build(self, name: str, robot: Robot) -> BaseVelocity:
        return BaseVelocity(name, robot, self)


class BaseVelocity(MotionGenerator):
    """Three commands, :class:`BaseVelocityConfig`."""

    def __init__(self, name: str, robot: Robot, config: BaseVelocityConfig) -> None:
        joints = config.joint_indices(robot.spec, name)
        super().__init__(name, robot, joints, 3, (JointTarget.POSITION, JointTarget.VELOCITY))
        self.config = config
        """Settings, as the action term gives them."""
        self._limits = torch.tensor(config.limits, device=self.device)
        fastest = joint_limits(robot.spec, "velocity_limit")[joints]
        self._fastest = torch.as_tensor(fastest, dtype=torch.float32, device=self.device)
        self.clamped = torch.zeros(self.num_envs, dtype=torch.int64, device=self.device)
        """(N,) commands since the reset that asked for more than the limits of speed or yaw rate, and were kept to
        them."""

    def compute(self, inputs: Mapping[str, Tensor]) -> Mapping[str, Tensor]:
        command = inputs["command"]
        # The limit holds for the speed as a whole: a base is no faster along a diagonal.
        speed = torch.linalg.vector_norm(command[:, :2], dim=1, keepdim=True)
        planar, turn = command[:, :2] / speed.clamp_min(1.0), command[:, 2:].clamp(-1.0, 1.0)
        most = torch.maximum(speed, command[:, 2:].abs()).squeeze(1)
        # Counted for reports: clamping in silence would hide a wrongly scaled policy.
        self.clamped += most > 1.0 + ROUNDING
        positions = self.positions
        velocities = torch.cat((_turned(planar, positions[:, 2]), turn), dim=1) * self._limits
        # A base that a joint's limit holds back keeps its curve.
        velocities = velocities / (velocities.abs() / self._fastest).amax(1, keepdim=True).clamp_min(1.0)
        return {JointTarget.POSITION: positions, JointTarget.VELOCITY: velocities}

    def reset(self, env_ids: Tensor | None = None) -> None:
        self.clamped[slice(None) if env_ids is None else env_ids] = 0

    def memory(self) -> Mapping[str, Tensor]:
        return {"clamped": self.clamped}

    @property
    def base_limits(self) -> Tensor:
        return self._limits

    def encode(self, pose: Tensor, gripper_open: Tensor) -> Tensor:
        return command_towards(towards_pose(self.robot, self.joints, pose), self.positions[:, 2], self._limits)


def command_towards(displacement: Tensor, heading: Tensor, limits: Tensor) -> Tensor:
    """(N, 3) the command, within its limits, that closes a displacement of the base.

    Args:
        displacement: (N, 3) x and y in m, yaw in rad, in the axes of the plane.
        heading: (N,) rad, of the base in the plane.
        limits: (3,) :attr:`BaseVelocityConfig.limits`.
    """
    velocities = PURSUIT_RATE * displacement / limits
    # Commands are in the base's axes, displacements in those of the plane.
    planar = _turned(velocities[:, :2], -heading)
    excess = torch.linalg.vector_norm(planar, dim=1, keepdim=True).clamp_min(1.0)
    return torch.cat((planar / excess, velocities[:, 2:].clamp(-1.0, 1.0)), dim=1)


def _turned(vectors: Tensor, angle: Tensor) -> Tensor:
    """(N, 2) vectors turned by angles (N,)."""
    cos, sin = angle.cos(), angle.sin()
    x, y = vectors.unbind(1)
    return torch.stack((cos * x - sin * y, sin * x + cos * y), dim=1)


# 1/s: the velocity that an expert asks for, over the displacement that is left
_PURSUIT_RATE = 1.0


def differential_base_of(spec: RobotSpec) -> DifferentialBase:
    """The robot's two driven wheels.

    Raises:
        ConfigurationError: it has none.
    """
    if spec.differential_base is None:
        raise ConfigurationError(
            f"robot '{spec.name}' has no differential base: give its description one, or choose base_velocity for a "
            "planar base"
        )
    return spec.differential_base


class DifferentialWheels:
    """Speeds of the two wheels (left, right) for the base's own: forward m/s and turn rad/s.

    ``w = (v -+ omega track / 2) / radius`` (Siciliano et al., Robotics, 2009, section 11.2.1). Where a wheel would
    exceed its velocity limit both are slowed down alike, so that the base keeps to its curve.
    """

    def __init__(self, robot: Robot, joints: Sequence[int]) -> None:
        base = differential_base_of(robot.spec)
        device = robot.joint_positions.device
        half = base.track / 2.0
        self._mixing = torch.tensor([[1.0, 1.0], [-half, half]], device=device) / base.radius
        limits = joint_limits(robot.spec, "velocity_limit")[list(joints)]
        self.fastest = torch.as_tensor(limits, dtype=torch.float32, device=device)
        """(2,) rad/s of the wheels."""
        speed = base.radius * float(limits.min())
        self.alone = torch.tensor([speed, speed / half], device=device)
        """(2,) m/s and rad/s that the base reaches, each without the other."""

    def speeds(self, motion: Tensor) -> Tensor:
        """(N, 2) rad/s of the wheels for (N, 2) of the base."""
        speeds = motion @ self._mixing
        excess = (speeds.abs() / self.fastest).amax(1, keepdim=True).clamp_min(1.0)
        return speeds / excess


@dataclass(frozen=True, kw_only=True)
class DifferentialDriveConfig(ActionTerm):
    """A command is the velocity of a base on two driven wheels: (forward, turn).

    The wheels' speeds follow from the robot's :class:`~orbit_core.scene.DifferentialBase`, within their velocity limits
    (:class:`DifferentialWheels`). Position targets are put at the measured positions at every turn.
    """

    name: ClassVar[str] = "differential_drive"
    above_zero: ClassVar[tuple[str, ...]] = ("max_speed", "max_yaw_rate")
    unwanted_gains: ClassVar[tuple[str, ...]] = ("stiffness",)

    max_speed: float = 1.0
    """m/s of one unit of command."""
    max_yaw_rate: float = 1.0
    """rad/s of one unit of command."""

    def default_joints(self, spec: RobotSpec) -> Sequence[str]:
        base = differential_base_of(spec)
        return (base.left, base.right)

    @property
    def reference(self) -> str:
        return "the base's own axes: x forward, y to the left, z up"

    def components(self, spec: RobotSpec, name: str) -> tuple[str, ...]:
        return ("forward", "turn")

    def joint_indices(self, spec: RobotSpec, name: str) -> list[int]:
        """Indices of the left and the right wheel's joints, in this order."""
        joints = super().joint_indices(spec, name)
        base = differential_base_of(spec)
        wheels = [spec.articulation.joint_names.index(joint) for joint in (base.left, base.right)]
        if sorted(joints) != sorted(wheels):
            raise ConfigurationError(f"action term '{name}' turns the robot's two driven wheels: leave joints out")
        return wheels

    def build(self, name: str, robot: Robot) -> DifferentialDrive:
        return DifferentialDrive(name, robot, self)


class DifferentialDrive(MotionGenerator):
    """Two commands, :class:`DifferentialDriveConfig`."""

    def __init__(self, name: str, robot: Robot, config: DifferentialDriveConfig) -> None:
        joints = config.joint_indices(robot.spec, name)
        super().__init__(name, robot, joints, 2, (JointTarget.POSITION, JointTarget.VELOCITY))
        self._limits = torch.tensor([config.max_speed, config.max_yaw_rate], device=self.device)
        self._base_limits = torch.tensor([config.max_speed, 0.0, config.max_yaw_rate], device=self.device)
        self._wheels = DifferentialWheels(robot, joints)
        self.clamped = torch.zeros(self.num_envs, dtype=torch.int64, device=self.device)
        """(N,) commands since the reset that asked for more than the limits of speed or yaw rate, and were kept to
        them."""

    def compute(self, inputs: Mapping[str, Tensor]) -> Mapping[str, Tensor]:
        command = inputs["command"]
        # Counted for reports, as of a planar base.
        self.clamped += command.abs().amax(1) > 1.0 + ROUNDING
        speeds = self._wheels.speeds(command.clamp(-1.0, 1.0) * self._limits)
        return {JointTarget.POSITION: self.positions, JointTarget.VELOCITY: speeds}

    def reset(self, env_ids: Tensor | None = None) -> None:
        write_rows(self.clamped, 0, env_ids)

    def memory(self) -> Mapping[str, Tensor]:
        return {"clamped": self.clamped}

    @property
    def base_limits(self) -> Tensor:
        return self._base_limits

    def encode(self, pose: Tensor, gripper_open: Tensor) -> Tensor:
        """The base drives until it looks at the pose, and by as much as the end effector, or itself, is short of it."""
        effectors = self.robot.spec.end_effectors
        root = self.robot.root_pose
        frame = self.robot.frame_pose(effectors[0].frame) if effectors else root
        goal = quat_rotate_inverse(root[:, 3:], pose[:, :3] - root[:, :3])
        here = quat_rotate_inverse(root[:, 3:], frame[:, :3] - root[:, :3])
        heading = torch.atan2(goal[:, 1], goal[:, 0])
        short = (torch.linalg.vector_norm(goal[:, :2], dim=1) - here[:, 0]) * heading.cos()
        return (_PURSUIT_RATE * torch.stack((short, heading), 1) / self._limits).clamp(-1.0, 1.0)

    def encode_posture(self, positions: Tensor, pose: Tensor, gripper_open: Tensor) -> Tensor:
        """The base stands: where it turned, the positions of its arm would be those of another pose."""
        return torch.zeros(self.num_envs, self.command_size, device=self.device)
