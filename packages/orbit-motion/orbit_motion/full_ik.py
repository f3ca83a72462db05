"""Inverse kinematics to convergence, from several seeds, within limits; and the action term that commands poses by it.

Levenberg and Marquardt's method with Sugihara's damping, which grows with the error: Solvability-Unconcerned Inverse
Kinematics by the Levenberg-Marquardt Method, IEEE Transactions on Robotics 27(5), 2011. Steps are clipped to the
joints' limits. All environments and seeds are solved at once.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import ClassVar

import torch
from torch import Tensor

from orbit_core.actions.base import CommandMode, JointTarget, speed_limited_lead
from orbit_core.actions.differential_ik import PoseTermConfig
from orbit_core.actions.ik import IkSolution, PoseFollower
from orbit_core.dynamics.kinematics import KinematicTree
from orbit_core.dynamics.linear import solve_spd
from orbit_core.dynamics.transforms import pose_error, pose_inverse, pose_multiply
from orbit_core.interfaces import Robot

# rad or m by which a joint moves in one iteration
_LARGEST_STEP = 0.5
# Damping, m^2 or rad^2, that stays at the solution: it bounds the step in singular poses
_BIAS = 1e-6


@dataclass(frozen=True, kw_only=True)
class FullIkConfig:
    """Limits of the search, and the tolerances within which a pose counts as reached."""

    seeds: int = 16
    """Starts for each environment: the positions given, home, and others drawn evenly within the limits."""
    iterations: int = 60
    """Most steps from each start."""
    position_tolerance: float = 1e-4
    """m"""
    rotation_tolerance: float = 1e-3
    """rad"""


class FullIk:
    """Solves for some joints of an articulation, the others staying where they are.

    Args:
        tree: the kinematics.
        frame: a link or frame.
        joints: indices of the joints to solve for.
        limits: (J, 2) of all joints; infinite ones count as half a turn to either side of home.
        home: (J,) a posture to start from.
        config: how to search.
    """

    def __init__(
        self,
        tree: KinematicTree,
        frame: str,
        joints: Sequence[int],
        limits: Tensor,
        home: Tensor,
        config: FullIkConfig = FullIkConfig(),
    ) -> None:
        self.config = config
        self._tree, self._frame = tree, frame
        self._joints = torch.tensor(list(joints), device=home.device)
        self._home = home[self._joints]
        low, high = limits[self._joints].unbind(1)
        # A joint without limits is searched over a full turn around home.
        finite = low.isfinite() & high.isfinite()
        self._low = torch.where(finite, low, self._home - torch.pi)
        self._high = torch.where(finite, high, self._home + torch.pi)
        # A fixed seed: the same pose gives the same solution in every run.
        generator = torch.Generator().manual_seed(0)
        drawn = torch.rand(max(config.seeds - 2, 0), len(self._home), generator=generator).to(self._low.device)
        self._drawn = self._low + drawn * (self._high - self._low)

    def solve(self, pose: Tensor, positions: Tensor) -> IkSolution:
        """The solution that is nearest to ``positions`` (N, J) in the joint that travels most.

        Args:
            pose: (N, 7) of the frame in the root link.
            positions: (N, J) of all joints; also the first start.

        Where no start converges, what comes nearest to the pose is returned.
        """
        count = pose.shape[0]
        current = positions[:, self._joints]
        # The present posture first, so that a near solution wins over a far one.
        starts = (current[:, None], self._home.expand(count, 1, -1), self._drawn.expand(count, -1, -1))
        seeds = torch.cat(starts, 1)[:, : self.config.seeds]
        width = seeds.shape[1]
        full = positions.repeat_interleave(width, 0)
        full[:, self._joints] = seeds.flatten(0, 1)
        full, error = self._descend(pose.repeat_interleave(width, 0), full)
        found = full[:, self._joints].view(count, width, -1)
        position, rotation = (part.norm(dim=-1).view(count, width) for part in (error[:, :3], error[:, 3:]))
        good = (position <= self.config.position_tolerance) & (rotation <= self.config.rotation_tolerance)
        travel = (found - current[:, None]).abs().amax(-1)
        # Any that converged is better than any that did not.
        best = torch.where(good, travel, 1e3 + position + rotation).argmin(1)
        rows = torch.arange(count, device=pose.device)
        return IkSolution(found[rows, best], position[rows, best], rotation[rows, best], good[rows, best])

    def _descend(self, target: Tensor, full: Tensor) -> tuple[Tensor, Tensor]:
        """Positions (M, J) and errors (M, 6) after all iterations."""
        root = torch.zeros_like(target)
        root[:, 3] = 1.0
        for _ in range(self.config.iterations):
            links = self._tree.forward(root, full)
            error = pose_error(self._tree.frame_pose(links, self._frame), target)
            jacobian = self._tree.jacobian(links, self._frame)[:, :, self._joints]
            damping = (0.5 * error.square().sum(1).clamp(max=0.1) + _BIAS)[:, None, None]
            # Blocked joints get no step, or they would take it from the others.
            at_limit = self._blocked(full[:, self._joints], jacobian, error)
            step = _damped_step(jacobian.masked_fill(at_limit[:, None], 0.0), error, damping)
            # The linear model holds for small angles only.
            step = step.clamp(-_LARGEST_STEP, _LARGEST_STEP)
            full[:, self._joints] = torch.clamp(full[:, self._joints] + step, self._low, self._high)
        links = self._tree.forward(root, full)
        return full, pose_error(self._tree.frame_pose(links, self._frame), target)

    def _blocked(self, positions: Tensor, jacobian: Tensor, error: Tensor) -> Tensor:
        """(M, k) joints at a limit that the error pushes beyond it."""
        push = (jacobian.mT @ error[..., None])[..., 0]
        return ((positions <= self._low) & (push < 0.0)) | ((positions >= self._high) & (push > 0.0))


def _damped_step(jacobian: Tensor, error: Tensor, damping: Tensor) -> Tensor:
    square = jacobian @ jacobian.mT + damping * torch.eye(6, device=jacobian.device, dtype=jacobian.dtype)
    return (jacobian.mT @ solve_spd(square, error[..., None]))[..., 0]


@dataclass(frozen=True, kw_only=True)
class FullIkTermConfig(PoseTermConfig):
    """A command is a pose of the hand, to whose joint positions the joints go together; the hand's path is free.

    Levenberg and Marquardt's method from several seeds (:class:`FullIk`). Where no seed converges the
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
    """Most steps from each start."""
    limit_speed: bool = True
    """Keep targets within :func:`orbit_core.actions.base.speed_limited_lead` of the measured positions."""

    def build(self, name: str, robot: Robot) -> FullIkTerm:
        return FullIkTerm(name, robot, self)


class FullIkTerm(PoseFollower):
    """Six commands, :class:`FullIkTermConfig`. Targets are within the joints' limits."""

    def __init__(self, name: str, robot: Robot, config: FullIkTermConfig) -> None:
        super().__init__(name, robot, config.joint_indices(robot.spec, name), 6, (JointTarget.POSITION,))
        self.config = config
        """Settings, as the action term gives them."""
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
