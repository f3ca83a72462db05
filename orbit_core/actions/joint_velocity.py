"""Commands are joint velocities, or changes of them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar

import torch
from torch import Tensor

from orbit_core.actions.base import JointTarget, MotionGenerator
from orbit_core.actions.ik import towards_pose
from orbit_core.actions.modes import CommandMode, LastTargets
from orbit_core.actions.term import ActionTerm
from orbit_core.interfaces import Robot
from orbit_core.interfaces.layout import joint_limits

_PURSUIT_RATE = 5.0
"""1/s: the velocity that an expert asks for, over the displacement that is left."""


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

    def build(self, name: str, robot: Robot) -> JointVelocity:
        return JointVelocity(name, robot, self)


class JointVelocity(MotionGenerator):
    """One command a joint, :class:`JointVelocityConfig`."""

    bounded = True

    def __init__(self, name: str, robot: Robot, config: JointVelocityConfig) -> None:
        joints = config.joint_indices(robot.spec, name)
        super().__init__(name, robot, joints, len(joints), (JointTarget.POSITION, JointTarget.VELOCITY))
        self.config = config
        limits = joint_limits(robot.spec, "velocity_limit")[joints]
        self._fastest = torch.as_tensor(limits, dtype=torch.float32, device=self.device)
        self._last = LastTargets(self.num_envs, (len(joints),), self.device)

    def compute(self, inputs: Mapping[str, Tensor]) -> Mapping[str, Tensor]:
        targets = self._origin() + self.config.scale * inputs["command"]
        targets = torch.clamp(targets, -self._fastest, self._fastest)
        if self.config.mode is CommandMode.INTEGRATED:
            self._last.keep(targets)
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
        """What commands are added to."""
        if self.config.mode is CommandMode.ABSOLUTE:
            return 0.0
        return self.velocities if self.config.mode is CommandMode.RELATIVE else self._last.read(self.velocities)
