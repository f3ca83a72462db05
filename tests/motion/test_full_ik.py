"""Full inverse kinematics finds joint positions within limits for poses that an arm reaches."""

from __future__ import annotations

from dataclasses import dataclass

import pytest
import torch
from torch import Tensor

from orbit_assets.catalogue import robot, robot_names
from orbit_core.dynamics.kinematics import KinematicTree
from orbit_core.dynamics.transforms import pose_error
from orbit_core.interfaces.layout import home_positions
from orbit_core.interfaces.names import match_names
from orbit_motion.full_ik import FullIk


@dataclass
class Arm:
    solver: FullIk
    tree: KinematicTree
    joints: list[int]
    limits: Tensor
    home: Tensor
    frame: str

    def hand(self, positions: Tensor) -> Tensor:
        """(N, 7) in the root."""
        root = torch.tensor([[0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0]]).repeat(len(positions), 1)
        return self.tree.frame_pose(self.tree.forward(root, positions), self.frame)

    def anywhere(self, count: int) -> Tensor:
        """(N, J) within the limits, the joints of the arm alone moved."""
        torch.manual_seed(3)
        low, high = self.limits[self.joints].clamp(-torch.pi, torch.pi).unbind(1)
        positions = self.home.repeat(count, 1)
        positions[:, self.joints] = low + torch.rand(count, len(self.joints)) * (high - low)
        return positions


def arm(name: str) -> Arm:
    spec = robot(name)
    tree, effector = KinematicTree(spec.articulation), spec.end_effector
    joints = match_names(effector.arm_joints, spec.articulation.joint_names, "joint", name)
    limits = torch.tensor([(joint.lower_limit, joint.upper_limit) for joint in spec.articulation.movable_joints])
    home = torch.as_tensor(home_positions(spec), dtype=torch.float32)
    return Arm(FullIk(tree, effector.frame, joints, limits, home), tree, joints, limits, home, effector.frame)


def test_poses_of_every_arm_of_the_catalogue_are_reached() -> None:
    """A few of each; ``benchmarks/full_ik.py`` takes a thousand."""
    rates: dict[str, float] = {}
    for name in robot_names():
        spec = robot(name)
        if spec.has_arm and spec.end_effector.arm_joints:
            body = arm(name)
            solution = body.solver.solve(body.hand(body.anywhere(8)), body.home.repeat(8, 1))
            rates[name] = float(solution.converged.float().mean())
    assert len(rates) > 15
    assert min(rates.values()) > 0.74, rates
    assert sum(rates.values()) / len(rates) >= 0.95


@pytest.mark.parametrize("name", ["franka_panda", "ur5"])
def test_nearly_every_reachable_pose_is_reached_within_the_limits(name: str) -> None:
    body = arm(name)
    poses, start = body.hand(body.anywhere(120)), body.home.repeat(120, 1)
    solution = body.solver.solve(poses, start)
    assert solution.converged.float().mean() >= 0.95
    found = start.clone()
    found[:, body.joints] = solution.positions
    error = pose_error(body.hand(found), poses)[solution.converged]
    assert error[:, :3].norm(dim=1).max() <= 1.1e-4
    assert error[:, 3:].norm(dim=1).max() <= 1.1e-3
    bounded = body.limits[body.joints].isfinite().all(1)
    low, high = body.limits[body.joints].unbind(1)
    within = (solution.positions >= low - 1e-5) & (solution.positions <= high + 1e-5)
    assert within[:, bounded].all()


def test_the_solution_that_is_nearest_to_where_the_joints_are_is_taken() -> None:
    body = arm("franka_panda")
    near = body.home.repeat(20, 1)
    torch.manual_seed(0)
    near[:, body.joints] += 0.2 * (torch.rand(20, len(body.joints)) - 0.5)
    near = near.maximum(body.limits[:, 0]).minimum(body.limits[:, 1])
    solution = body.solver.solve(body.hand(near), body.home.repeat(20, 1))
    assert solution.converged.all()
    assert (solution.positions - body.home[body.joints]).abs().max() < 0.5


def test_a_pose_out_of_reach_comes_as_near_as_it_can_and_says_so() -> None:
    body = arm("franka_panda")
    solution = body.solver.solve(torch.tensor([[2.0, 0.0, 0.3, 0.0, 1.0, 0.0, 0.0]]), body.home[None])
    assert not solution.converged.any()
    assert 0.9 < float(solution.position_error) < 1.3  # it reaches some 0.85 m from its shoulder
