"""Inverse kinematics to convergence: joint positions that bring a frame to a pose, from several seeds, within limits.

Levenberg and Marquardt's method with Sugihara's damping, which grows with the error: Solvability-Unconcerned Inverse
Kinematics by the Levenberg-Marquardt Method, IEEE Transactions on Robotics 27(5), 2011. Steps are clipped to the
joints' limits. All environments and seeds are solved at once.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import torch
from torch import Tensor

from orbit_core.dynamics.kinematics import KinematicTree
from orbit_core.dynamics.transforms import pose_error, pose_inverse, pose_multiply
from orbit_core.interfaces import Robot

_LARGEST_STEP = 0.5
"""rad or m by which a joint moves in one iteration."""
_BIAS = 1e-4
"""Damping (squared, m^2 or rad^2) that stays at the solution: it bounds the step in singular poses."""


@dataclass(frozen=True, kw_only=True)
class FullIkConfig:
    """How long to search, and when a pose counts as reached."""

    seeds: int = 16
    """Starts for each environment: the positions given, home, and others drawn evenly within the limits."""
    iterations: int = 60
    position_tolerance: float = 1e-4
    """m"""
    rotation_tolerance: float = 1e-3
    """rad"""


@dataclass(frozen=True, eq=False)
class IkSolution:
    """For N environments: positions (N, k), what is missing to the pose in m and rad (N,), and whether it is reached."""

    positions: Tensor
    position_error: Tensor
    rotation_error: Tensor
    converged: Tensor


class FullIk:
    """Solves for some joints of a robot, the others staying where they are.

    Args:
        robot: its description, home and limits are read, and the number of environments.
        frame: a link or frame.
        joints: indices of the joints to solve for.
        config: how to search.
    """

    def __init__(self, robot: Robot, frame: str, joints: Sequence[int], config: FullIkConfig = FullIkConfig()) -> None:
        self.config = config
        self._robot, self._frame, self._joints = robot, frame, list(joints)
        self._tree = KinematicTree(robot.spec.articulation, robot.home_positions.device)
        self._home = robot.home_positions[self._joints]
        limits = robot.position_limits[self._joints]
        finite = limits.isfinite().all(1)
        self._low = torch.where(finite, limits[:, 0], self._home - torch.pi)
        self._high = torch.where(finite, limits[:, 1], self._home + torch.pi)
        generator = torch.Generator().manual_seed(0)
        drawn = torch.rand(max(config.seeds - 2, 0), len(self._joints), generator=generator).to(self._low.device)
        self._drawn = self._low + drawn * (self._high - self._low)

    def solve(self, pose: Tensor) -> IkSolution:
        """The solution nearest to the joints' measured positions, for poses (N, 7) in each environment's frame.

        Where no seed converges, the best one is returned.
        """
        robot, count = self._robot, pose.shape[0]
        current = robot.joint_positions[:, self._joints]
        starts = (current[:, None], self._home.expand(count, 1, -1), self._drawn.expand(count, -1, -1))
        seeds = torch.cat(starts, 1)[:, : self.config.seeds]
        width = seeds.shape[1]
        local = pose_multiply(pose_inverse(robot.root_pose), pose).repeat_interleave(width, 0)
        full = robot.joint_positions.repeat_interleave(width, 0)
        full, error = self._descend(local, full, seeds.flatten(0, 1))
        found = full[:, self._joints].view(count, width, -1)
        position, rotation = (part.norm(dim=-1).view(count, width) for part in (error[:, :3], error[:, 3:]))
        good = (position <= self.config.position_tolerance) & (rotation <= self.config.rotation_tolerance)
        travel = (found - current[:, None]).abs().amax(-1)
        # Any that converged is better than any that did not; among those the shortest way, else the smallest error.
        best = torch.where(good, travel, 1e3 + position + rotation).argmin(1)
        rows = torch.arange(count, device=pose.device)
        return IkSolution(found[rows, best], position[rows, best], rotation[rows, best], good[rows, best])

    def _descend(self, target: Tensor, full: Tensor, seeds: Tensor) -> tuple[Tensor, Tensor]:
        """Positions (M, J) and errors (M, 6) after all iterations."""
        root = torch.zeros_like(target)
        root[:, 3] = 1.0
        full[:, self._joints] = seeds
        for _ in range(self.config.iterations):
            links = self._tree.forward(root, full)
            error = pose_error(self._tree.frame_pose(links, self._frame), target)
            jacobian = self._tree.jacobian(links, self._frame)[:, :, self._joints]
            damping = (0.5 * error.square().sum(1).clamp(max=0.1) + _BIAS * 1e-2)[:, None, None]
            at_limit = self._blocked(full[:, self._joints], jacobian, error)
            step = _damped_step(jacobian.masked_fill(at_limit[:, None], 0.0), error, damping)
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
    return (jacobian.mT @ torch.linalg.solve(square, error[..., None]))[..., 0]
