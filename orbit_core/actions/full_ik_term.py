"""Commands are poses of the hand, whose joint positions full inverse kinematics finds."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar

import torch
from torch import Tensor

from orbit_core.actions.base import JointTarget, speed_limited_lead
from orbit_core.actions.differential_ik import PoseTermConfig
from orbit_core.actions.full_ik import FullIk, FullIkConfig
from orbit_core.actions.modes import CommandMode
from orbit_core.actions.reach import PoseFollower
from orbit_core.dynamics.kinematics import KinematicTree
from orbit_core.dynamics.transforms import pose_inverse, pose_multiply
from orbit_core.interfaces import Robot


@dataclass(frozen=True, kw_only=True)
class FullIkTermConfig(PoseTermConfig):
    """A command is a pose of the hand, to whose joint positions the joints go together, whatever way the hand takes.

    Levenberg and Marquardt's method from several seeds (:mod:`orbit_core.actions.full_ik`). Where no seed converges the
    joints hold still, and :attr:`FullIkTerm.missing` says by how much the pose is out of reach.
    """

    name: ClassVar[str] = "full_ik"
    above_zero: ClassVar[tuple[str, ...]] = (*PoseTermConfig.above_zero, "seeds", "iterations")

    mode: CommandMode = CommandMode.ABSOLUTE
    position_scale: float = 0.5
    rotation_scale: float = 3.141592653589793
    seeds: int = 4
    """Starts: the measured positions, home, and others within the limits."""
    iterations: int = 20
    limit_speed: bool = True
    """Keep targets within :func:`orbit_core.actions.base.speed_limited_lead` of the measured positions."""

    def build(self, name: str, robot: Robot) -> FullIkTerm:
        return FullIkTerm(name, robot, self)


class FullIkTerm(PoseFollower):
    """Six commands, :class:`FullIkTermConfig`. Targets are within the joints' limits."""

    def __init__(self, name: str, robot: Robot, config: FullIkTermConfig) -> None:
        super().__init__(name, robot, config.joint_indices(robot.spec, name), 6, (JointTarget.POSITION,))
        self.config = config
        self.frame = config.frame_of(robot)
        self._pose = config.pose_command(robot)
        tree = KinematicTree(robot.spec.articulation, self.device)
        search = FullIkConfig(seeds=config.seeds, iterations=config.iterations)
        self._solver = FullIk(tree, self.frame, self.joints, robot.position_limits, robot.home_positions, search)
        self._lead = speed_limited_lead(robot, self.joints) if config.limit_speed else None
        self.missing = torch.zeros(self.num_envs, 2, device=self.device)
        """(N, 2) m and rad from the nearest pose found to the one last asked for."""

    def compute(self, inputs: Mapping[str, Tensor]) -> Mapping[str, Tensor]:
        local = pose_multiply(pose_inverse(self.robot.root_pose), self._pose.target(inputs["command"]))
        solution = self._solver.solve(local, self.robot.joint_positions)
        self.missing.copy_(torch.stack((solution.position_error, solution.rotation_error), 1))
        positions = self.positions
        targets = torch.where(solution.converged.unsqueeze(1), solution.positions, positions)
        if self._lead is not None:
            # Slowed down together, so that all joints arrive at once.
            share = (self._lead / (targets - positions).abs().clamp_min(1e-9)).amin(1, keepdim=True).clamp_max(1.0)
            targets = positions + share * (targets - positions)
        return {JointTarget.POSITION: torch.clamp(targets, self.lower_limits, self.upper_limits)}

    def encode(self, pose: Tensor, gripper_open: Tensor) -> Tensor:
        return self._pose.encode(pose)

    def reset(self, env_ids: Tensor | None = None) -> None:
        self._pose.reset(env_ids)

    def memory(self) -> Mapping[str, Tensor]:
        return {**self._pose.memory(), "missing": self.missing}
