"""Commands of joints: positions, velocities and efforts."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar

import torch
from torch import Tensor

from orbit_core.actions.arm_dynamics import ArmDynamics
from orbit_core.actions.base import CommandMode, JointTarget, LastTargets, MotionGenerator, speed_limited_lead
from orbit_core.actions.ik import towards_pose
from orbit_core.actions.term import ActionTerm
from orbit_core.interfaces import ConfigurationError, Robot
from orbit_core.interfaces.layout import joint_limits


@dataclass(frozen=True, kw_only=True)
class JointPositionConfig(ActionTerm):
    """A command is the position of each joint, or its change.

    Targets are clipped to the joints' limits, and to what ``limit_speed`` says. Absolute: ``target = home + scale *
    command``. Relative: ``target = measured position + scale * command``. Integrated: ``target += scale * command``,
    from the measured positions after a reset.
    """

    name: ClassVar[str] = "joint_position"
    above_zero: ClassVar[tuple[str, ...]] = ("scale",)

    scale: float | None = 0.5
    """rad or m. None (absolute only) puts -1, 0 and 1 at lower limit, home and upper limit, linear in between; a
    joint without limits takes half a turn either way."""
    mode: CommandMode = CommandMode.ABSOLUTE
    """Reference that a command counts from; absolute is most common in learning."""
    limit_speed: bool = False
    """Keep targets within :func:`orbit_core.actions.base.speed_limited_lead` of the measured positions."""

    def build(self, name: str, robot: Robot) -> JointPosition:
        return JointPosition(name, robot, self)


class JointPosition(MotionGenerator):
    """One command a joint, :class:`JointPositionConfig`."""

    bounded = True

    def __init__(self, name: str, robot: Robot, config: JointPositionConfig) -> None:
        joints = config.joint_indices(robot.spec, name)
        super().__init__(name, robot, joints, len(joints), (JointTarget.POSITION,))
        if config.scale is None and config.mode is not CommandMode.ABSOLUTE:
            raise ConfigurationError("a relative joint position space needs a scale: give it in rad or m per command")
        self.config = config
        """Settings, as the action term gives them."""
        self._home = robot.home_positions[joints]
        self._above, self._below = self._spans()
        self._lead = speed_limited_lead(robot, joints) if config.limit_speed else None
        self._last = LastTargets(self.num_envs, (len(joints),), self.device)

    def compute(self, inputs: Mapping[str, Tensor]) -> Mapping[str, Tensor]:
        command = inputs["command"]
        span = torch.where(command < 0.0, self._below, self._above) if self.config.scale is None else self._above
        # The common mode reads no state, which saves the call and the gather.
        origin = self._home if self.config.mode is CommandMode.ABSOLUTE else self._origin()
        targets = torch.addcmul(origin, command, span)
        if self._lead is not None:
            positions = self.positions
            targets = torch.clamp(targets, positions - self._lead, positions + self._lead)
        # Limits last: a lead must not carry a target beyond them.
        targets = torch.clamp(targets, self.lower_limits, self.upper_limits)
        if self.config.mode is CommandMode.INTEGRATED:
            self._last.keep(targets)
        return {JointTarget.POSITION: targets}

    def encode(self, pose: Tensor, gripper_open: Tensor) -> Tensor:
        return self.encode_positions(self.positions + towards_pose(self.robot, self.joints, pose))

    def share(self, pose: Tensor) -> Tensor:
        """Return the share of one damped least-squares step that the slowest joint's lead allows."""
        if self._lead is None:
            return super().share(pose)
        step = towards_pose(self.robot, self.joints, pose).abs()
        return (self._lead / step.clamp_min(1e-9)).amin(1, keepdim=True).clamp(max=1.0)

    @property
    def position_range(self) -> Tensor:
        if self.config.mode is not CommandMode.ABSOLUTE:
            return super().position_range
        low, high = super().position_range.unbind(1)
        return torch.stack((low.maximum(self._home - self._below), high.minimum(self._home + self._above)), 1)

    @property
    def lead(self) -> Tensor | None:
        return self._lead

    @property
    def home(self) -> Tensor:
        """Home positions (k,) of the joints, rad or m."""
        return self._home

    @property
    def spans(self) -> tuple[Tensor, Tensor]:
        """Ways (k,) of a command of 1 and of one of -1, rad or m."""
        return self._above, self._below

    @property
    def affine(self) -> tuple[Tensor, Tensor] | None:
        # Only equal spans on both sides of home make the map affine.
        straight = torch.allclose(self._above, self._below)
        return (self._home, self._above) if straight and self.config.mode is CommandMode.ABSOLUTE else None

    def encode_posture(self, positions: Tensor, pose: Tensor, gripper_open: Tensor) -> Tensor:
        return self.encode_positions(positions[:, self._columns])

    def encode_positions(self, positions: Tensor) -> Tensor:
        """The command (N, k) whose targets are nearest to ``positions`` (N, k)."""
        offset = positions - self._origin()
        span = torch.where(offset < 0.0, self._below, self._above)
        # A joint whose home is at its limit has no span on that side.
        return (offset / span.clamp_min(1e-6)).clamp(-1.0, 1.0)

    def reset(self, env_ids: Tensor | None = None) -> None:
        self._last.reset(env_ids)

    def memory(self) -> Mapping[str, Tensor]:
        return self._last.memory() if self.config.mode is CommandMode.INTEGRATED else {}

    def _origin(self) -> Tensor:
        """(k,) or (N, k) what commands are added to."""
        if self.config.mode is CommandMode.ABSOLUTE:
            return self._home
        return self.positions if self.config.mode is CommandMode.RELATIVE else self._last.read(self.positions)

    def _spans(self) -> tuple[Tensor, Tensor]:
        if self.config.scale is not None:
            span = torch.full_like(self._home, self.config.scale)
            return span, span
        above, below = self.upper_limits - self._home, self._home - self.lower_limits
        return tuple(torch.where(span.isfinite(), span, math.pi) for span in (above, below))  # pyright: ignore


# 1/s: the velocity that an expert asks for, over the displacement that is left
_PURSUIT_RATE = 5.0


@dataclass(frozen=True, kw_only=True)
class JointVelocityConfig(ActionTerm):
    """A command is the velocity of each joint, or its change.

    Absolute: ``velocity target = scale * command``. Relative: the measured velocity is added. Integrated: the last
    target is added, from the measured velocities after a reset. Targets are clipped to the joints' velocity limits. The
    position target is put at the measured position at every turn, so that a drive with stiffness resists the motion
    only by as much as it moves between two turns; a drive meant for velocities has none.
    """

    name: ClassVar[str] = "joint_velocity"
    above_zero: ClassVar[tuple[str, ...]] = ("scale",)
    unwanted_gains: ClassVar[tuple[str, ...]] = ("stiffness",)

    scale: float = 1.0
    """rad/s or m/s."""
    mode: CommandMode = CommandMode.ABSOLUTE
    """Reference that a command counts from."""

    def build(self, name: str, robot: Robot) -> JointVelocity:
        return JointVelocity(name, robot, self)


class JointVelocity(MotionGenerator):
    """One command a joint, :class:`JointVelocityConfig`."""

    bounded = True

    def __init__(self, name: str, robot: Robot, config: JointVelocityConfig) -> None:
        joints = config.joint_indices(robot.spec, name)
        super().__init__(name, robot, joints, len(joints), (JointTarget.POSITION, JointTarget.VELOCITY))
        self.config = config
        """Settings, as the action term gives them."""
        limits = joint_limits(robot.spec, "velocity_limit")[joints]
        self._fastest = torch.as_tensor(limits, dtype=torch.float32, device=self.device)
        self._last = LastTargets(self.num_envs, (len(joints),), self.device)

    def compute(self, inputs: Mapping[str, Tensor]) -> Mapping[str, Tensor]:
        targets = self._origin() + self.config.scale * inputs["command"]
        targets = torch.clamp(targets, -self._fastest, self._fastest)
        if self.config.mode is CommandMode.INTEGRATED:
            self._last.keep(targets)
        # The position target follows the joint, so that stiffness does not work against the velocity.
        return {JointTarget.POSITION: self.positions, JointTarget.VELOCITY: targets}

    def encode(self, pose: Tensor, gripper_open: Tensor) -> Tensor:
        return self._pursuing(towards_pose(self.robot, self.joints, pose))

    def encode_positions(self, positions: Tensor) -> Tensor:
        """The command (N, k) that lets the joints go to ``positions`` (N, k)."""
        return self._pursuing(positions - self.positions)

    def reset(self, env_ids: Tensor | None = None) -> None:
        self._last.reset(env_ids)

    def memory(self) -> Mapping[str, Tensor]:
        return self._last.memory() if self.config.mode is CommandMode.INTEGRATED else {}

    def _pursuing(self, displacement: Tensor) -> Tensor:
        velocities = _PURSUIT_RATE * displacement - self._origin()
        # Slowed down together, so that the hand keeps its direction.
        return velocities / velocities.abs().amax(-1, keepdim=True).clamp_min(self.config.scale)

    def _origin(self) -> Tensor | float:
        """Return the origin that commands are added to."""
        if self.config.mode is CommandMode.ABSOLUTE:
            return 0.0
        return self.velocities if self.config.mode is CommandMode.RELATIVE else self._last.read(self.velocities)


# rad/s: of the critically damped motion that an expert asks for
_PURSUIT_FREQUENCY = 6.0


@dataclass(frozen=True, kw_only=True)
class JointEffortConfig(ActionTerm):
    """A command is the effort of each joint, or its change.

    Absolute: ``effort target = scale * command``. Relative: the effort applied in the last physics step is added.
    Integrated: the last target is added, from the applied efforts after a reset. Targets are clipped to the joints'
    effort limits. Position and velocity targets are put at the measured state at every turn, so that a drive with gains
    resists only what changes between two turns; a drive meant for efforts has none.
    """

    name: ClassVar[str] = "joint_effort"
    above_zero: ClassVar[tuple[str, ...]] = ("scale",)
    unwanted_gains: ClassVar[tuple[str, ...]] = (
        "stiffness",
        "damping",
    )

    scale: float | None = None
    """N m or N; None takes each joint's effort limit."""
    mode: CommandMode = CommandMode.ABSOLUTE
    """Reference that a command counts from."""

    def build(self, name: str, robot: Robot) -> JointEffort:
        return JointEffort(name, robot, self)


class JointEffort(MotionGenerator):
    """One command a joint, :class:`JointEffortConfig`."""

    bounded = True

    def __init__(self, name: str, robot: Robot, config: JointEffortConfig) -> None:
        joints = config.joint_indices(robot.spec, name)
        super().__init__(name, robot, joints, len(joints), tuple(JointTarget))
        self.config = config
        """Settings, as the action term gives them."""
        scales = _effort_limits(robot, joints) if config.scale is None else [config.scale] * len(joints)
        self._scale = torch.tensor(scales, device=self.device)
        limits = joint_limits(robot.spec, "effort_limit")[joints]
        self._strongest = torch.as_tensor(limits, dtype=torch.float32, device=self.device)
        self._weakest = -self._strongest
        self._last = LastTargets(self.num_envs, (len(joints),), self.device)
        self._dynamics: ArmDynamics | None = None

    def compute(self, inputs: Mapping[str, Tensor]) -> Mapping[str, Tensor]:
        efforts = self._origin() + self._scale * inputs["command"]
        efforts = torch.clamp(efforts, self._weakest, self._strongest)
        if self.config.mode is CommandMode.INTEGRATED:
            self._last.keep(efforts)
        return {
            JointTarget.POSITION: self.positions,
            JointTarget.VELOCITY: self.velocities,
            JointTarget.EFFORT: efforts,
        }

    def encode(self, pose: Tensor, gripper_open: Tensor) -> Tensor:
        """Computed torque: the efforts that accelerate the joints towards ``pose``, with the base and all others held.

        Drives are not in the model.
        """
        return self._pursuing(towards_pose(self.robot, self.joints, pose))

    def encode_positions(self, positions: Tensor) -> Tensor:
        """The command (N, k) that accelerates the joints towards ``positions`` (N, k), likewise."""
        return self._pursuing(positions - self.positions)

    def encode_efforts(self, efforts: Tensor) -> Tensor:
        """The command that asks for efforts (N, joints) in N m or N, as far as it can."""
        return ((efforts - self._origin()) / self._scale).clamp(-1.0, 1.0)

    def reset(self, env_ids: Tensor | None = None) -> None:
        self._last.reset(env_ids)

    def memory(self) -> Mapping[str, Tensor]:
        return self._last.memory() if self.config.mode is CommandMode.INTEGRATED else {}

    def _pursuing(self, displacement: Tensor) -> Tensor:
        frequency = _PURSUIT_FREQUENCY
        # Critically damped, so that the motion of an expert does not overshoot.
        acceleration = frequency**2 * displacement - 2.0 * frequency * self.velocities
        # Built on first use: only experts need the model, and it costs some milliseconds.
        if self._dynamics is None:
            self._dynamics = ArmDynamics(self.robot, self.joints)
        state = self._dynamics.state()
        return self.encode_efforts(self._dynamics.against_friction(state, acceleration, state.efforts(acceleration)))

    def _origin(self) -> Tensor | float:
        """Return the origin that commands are added to."""
        if self.config.mode is CommandMode.ABSOLUTE:
            return 0.0
        applied = self.robot.joint_efforts[:, self._columns]
        return applied if self.config.mode is CommandMode.RELATIVE else self._last.read(applied)


def _effort_limits(robot: Robot, joints: list[int]) -> list[float]:
    limits = joint_limits(robot.spec, "effort_limit")
    for joint in joints:
        if not 0.0 < limits[joint] < float("inf"):
            raise ConfigurationError(
                f"joint '{robot.joint_names[joint]}' of '{robot.name}' has effort limit {limits[joint]}, which scales "
                "no command: give JointEffortConfig a scale"
            )
    return limits[joints].tolist()
