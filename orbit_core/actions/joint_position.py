"""Commands are joint positions, or changes of them."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar

import torch
from torch import Tensor

from orbit_core.actions.base import JointTarget, MotionGenerator, speed_limited_lead
from orbit_core.actions.ik import towards_pose
from orbit_core.actions.modes import CommandMode, LastTargets
from orbit_core.actions.term import ActionTerm
from orbit_core.interfaces import ConfigurationError, Robot


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
        self._home = robot.home_positions[joints]
        self._above, self._below = self._spans()
        self._lead = speed_limited_lead(robot, joints) if config.limit_speed else None
        self._last = LastTargets(self.num_envs, (len(joints),), self.device)

    def compute(self, inputs: Mapping[str, Tensor]) -> Mapping[str, Tensor]:
        command = inputs["command"]
        span = torch.where(command < 0.0, self._below, self._above) if self.config.scale is None else self._above
        origin = self._home if self.config.mode is CommandMode.ABSOLUTE else self._origin()
        targets = torch.addcmul(origin, command, span)
        if self._lead is not None:
            positions = self.positions
            targets = torch.clamp(targets, positions - self._lead, positions + self._lead)
        targets = torch.clamp(targets, self.lower_limits, self.upper_limits)
        if self.config.mode is CommandMode.INTEGRATED:
            self._last.keep(targets)
        return {JointTarget.POSITION: targets}

    def encode(self, pose: Tensor, gripper_open: Tensor) -> Tensor:
        return self.encode_positions(self.positions + towards_pose(self.robot, self.joints, pose))

    def share(self, pose: Tensor) -> Tensor:
        """As much as the slowest joint's lead lets it go of one damped least-squares step."""
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
    def affine(self) -> tuple[Tensor, Tensor] | None:
        straight = torch.allclose(self._above, self._below)
        return (self._home, self._above) if straight and self.config.mode is CommandMode.ABSOLUTE else None

    def encode_posture(self, positions: Tensor, pose: Tensor, gripper_open: Tensor) -> Tensor:
        return self.encode_positions(positions[:, self._columns])

    def encode_positions(self, positions: Tensor) -> Tensor:
        """The command (N, k) whose targets are nearest to ``positions`` (N, k)."""
        offset = positions - self._origin()
        span = torch.where(offset < 0.0, self._below, self._above)
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
