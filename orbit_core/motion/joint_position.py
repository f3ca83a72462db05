"""Commands are joint positions, or changes of them."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar

import torch
from torch import Tensor

from orbit_core.interfaces import ConfigurationError, Robot
from orbit_core.motion.base import JointTarget, MotionGenerator, speed_limited_lead
from orbit_core.motion.ik import towards_pose
from orbit_core.motion.term import ActionTerm


@dataclass(frozen=True, kw_only=True)
class JointPositionConfig(ActionTerm):
    """A command is the position of each joint, or its change.

    Targets are clipped to the joints' limits, and to what ``limit_speed`` says. Absolute: ``target = home + scale *
    command``. Relative: ``target += scale * command``, from the measured positions after a reset.
    """

    name: ClassVar[str] = "joint_position"

    scale: float | None = 0.5
    """rad or m. None (absolute only) puts -1, 0 and 1 at lower limit, home and upper limit, linear in between; a
    joint without limits takes half a turn either way."""
    relative: bool = False
    limit_speed: bool = False
    """Whether targets lead the measured positions by no more than :func:`orbit_core.motion.base.speed_limited_lead`."""

    def build(self, name: str, robot: Robot) -> JointPosition:
        return JointPosition(name, robot, self)


class JointPosition(MotionGenerator):
    """One command a joint, :class:`JointPositionConfig`."""

    def __init__(self, name: str, robot: Robot, config: JointPositionConfig) -> None:
        joints = config.joint_indices(robot.spec, name)
        super().__init__(name, robot, joints, len(joints), (JointTarget.POSITION,))
        if config.scale is None and config.relative:
            raise ConfigurationError("a relative joint position space needs a scale: give it in rad or m per command")
        self.config = config
        self._home = robot.home_positions[joints]
        self._above, self._below = self._spans()
        self._lead = speed_limited_lead(robot, joints) if config.limit_speed else None
        self._targets = torch.zeros(self.num_envs, len(joints), device=self.device)
        self._stale = torch.ones(self.num_envs, 1, dtype=torch.bool, device=self.device)

    def compute(self, inputs: Mapping[str, Tensor]) -> Mapping[str, Tensor]:
        command = inputs["command"]
        if not self.config.relative:
            span = torch.where(command < 0.0, self._below, self._above) if self.config.scale is None else self._above
            targets = torch.addcmul(self._home, command, span)
        else:
            targets = torch.addcmul(self._last_targets(), command, self._above)
        if self._lead is not None:
            positions = self.positions
            targets = torch.clamp(targets, positions - self._lead, positions + self._lead)
        targets = torch.clamp(targets, self.lower_limits, self.upper_limits)
        if self.config.relative:
            self._targets.copy_(targets)
            self._stale.zero_()
        return {JointTarget.POSITION.value: targets}

    def encode(self, pose: Tensor, gripper_open: Tensor) -> Tensor:
        return self.encode_positions(self.positions + towards_pose(self.robot, self.joints, pose))

    @property
    def position_range(self) -> Tensor:
        if self.config.relative:
            return super().position_range
        low, high = super().position_range.unbind(1)
        return torch.stack((low.maximum(self._home - self._below), high.minimum(self._home + self._above)), 1)

    def encode_posture(self, positions: Tensor, pose: Tensor, gripper_open: Tensor) -> Tensor:
        return self.encode_positions(positions[:, self._columns])

    def encode_positions(self, positions: Tensor) -> Tensor:
        """The command (N, k) whose targets are nearest to ``positions`` (N, k)."""
        offset = positions - (self._last_targets() if self.config.relative else self._home)
        span = torch.where(offset < 0.0, self._below, self._above)
        return (offset / span.clamp_min(1e-6)).clamp(-1.0, 1.0)

    def reset(self, env_ids: Tensor | None = None) -> None:
        self._stale[slice(None) if env_ids is None else env_ids] = True

    def memory(self) -> Mapping[str, Tensor]:
        return {"targets": self._targets, "stale": self._stale} if self.config.relative else {}

    def _last_targets(self) -> Tensor:
        # Read at the first turn and not at the reset: events may place the joints after it.
        return torch.where(self._stale, self.positions, self._targets)

    def _spans(self) -> tuple[Tensor, Tensor]:
        if self.config.scale is not None:
            span = torch.full_like(self._home, self.config.scale)
            return span, span
        above, below = self.upper_limits - self._home, self._home - self.lower_limits
        return tuple(torch.where(span.isfinite(), span, math.pi) for span in (above, below))  # pyright: ignore
