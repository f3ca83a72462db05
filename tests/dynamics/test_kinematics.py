"""Kinematics of random trees and of catalogue robots against MuJoCo's."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from orbit_assets.catalogue import robot
from orbit_core.dynamics.kinematics import KinematicTree, PointJacobian, mimic_matrix
from orbit_core.interfaces import UnknownNameError
from orbit_core.preparation.merge import merge_fixed_links
from orbit_core.scene import Articulation, Joint, JointType, Link, Mimic, Pose

Build = Callable[[Articulation, bool], Any]
seeds = st.integers(0, 2**32 - 1)


def _check_kinematics(reference: Any, seed: int) -> None:
    tree = KinematicTree(reference.articulation)
    reference.set_random_state(np.random.default_rng(seed))
    poses = tree.forward(reference.root_pose, reference.joint_positions)
    same_sign = (poses[..., 3:] * reference.link_poses[..., 3:]).sum(-1, keepdim=True).sign()
    torch.testing.assert_close(poses[..., :3], reference.link_poses[..., :3], atol=1e-5, rtol=1e-5)
    torch.testing.assert_close(poses[..., 3:] * same_sign, reference.link_poses[..., 3:], atol=1e-5, rtol=1e-5)
    velocities = tree.link_velocities(poses, reference.link_velocities[:, 0], reference.joint_velocities)
    torch.testing.assert_close(velocities, reference.link_velocities, atol=1e-4, rtol=1e-4)
    for index, name in enumerate(reference.articulation.link_names):
        jacobian = tree.jacobian(poses, name, floating_base=reference.floating)[0].numpy()
        np.testing.assert_allclose(jacobian, reference.jacobian(index), atol=1e-4)


@pytest.mark.parametrize("floating", [False, True])
@given(seed=seeds)
@settings(max_examples=25, deadline=None)
def test_random_trees_agree_with_mujoco(
    build_reference: Build, random_tree: Callable[[int], Articulation], floating: bool, seed: int
) -> None:
    _check_kinematics(build_reference(random_tree(seed), floating), seed)


@pytest.mark.parametrize(("name", "floating"), [("franka_panda", False), ("anymal_c", True)])
def test_robots_agree_with_mujoco(build_reference: Build, name: str, floating: bool) -> None:
    reference = build_reference(merge_fixed_links(robot(name).articulation), floating)
    for seed in range(3):
        _check_kinematics(reference, seed)


@given(seed=seeds)
@settings(max_examples=20, deadline=None)
def test_jacobian_is_the_derivative_of_a_point(random_tree: Callable[[int], Articulation], seed: int) -> None:
    articulation = random_tree(seed)
    tree = KinematicTree(articulation)
    generator = torch.Generator().manual_seed(seed)
    q = torch.rand(4, len(articulation.joint_names), generator=generator) * 2 - 1
    root = torch.tensor([0.3, -0.2, 0.1, 1.0, 0.0, 0.0, 0.0]).repeat(4, 1)
    step = 1e-2
    frame = articulation.link_names[-1]
    jacobian = tree.jacobian(tree.forward(root, q), frame)
    for joint in range(q.shape[1]):
        offset = torch.zeros_like(q)
        offset[:, joint] = step
        ahead, behind = (tree.frame_pose(tree.forward(root, q + s * offset), frame)[:, :3] for s in (1, -1))
        torch.testing.assert_close(jacobian[:, :3, joint], (ahead - behind) / (2 * step), atol=2e-4, rtol=1e-3)


def _two_slides() -> Articulation:
    """Fingers that slide apart along y; the second follows the first."""
    joints = tuple(
        Joint(
            f"finger{i}_joint", JointType.PRISMATIC, "hand", f"finger{i}", Pose((0.0, 0.0, 0.1)), axis=(0.0, sign, 0.0),
            mimic=Mimic("finger0_joint", 2.0) if i else None,
        )
        for i, sign in enumerate((1.0, -1.0))
    )  # fmt: skip
    return Articulation("hand", tuple(Link(name, 1.0) for name in ("hand", "finger0", "finger1")), joints)


@given(seed=seeds)
@settings(max_examples=20, deadline=None)
def test_a_frames_drift_is_the_jacobians_rate_times_the_velocity(
    random_tree: Callable[[int], Articulation], seed: int
) -> None:
    articulation = random_tree(seed)
    tree, count = KinematicTree(articulation, dtype=torch.float64), len(articulation.joint_names)
    random = torch.Generator().manual_seed(seed)
    positions, velocities = torch.randn(2, 1, count, generator=random, dtype=torch.float64).unbind()
    root = torch.tensor([[0.1, 0.2, 0.3, 0.5, 0.5, -0.5, 0.5]], dtype=torch.float64)
    frame, step = articulation.link_names[-1], 1e-5

    def twist(at: torch.Tensor) -> torch.Tensor:
        return (tree.jacobian(tree.forward(root, at), frame) @ velocities[..., None])[..., 0]

    expected = (twist(positions + step * velocities) - twist(positions - step * velocities)) / (2.0 * step)
    drift = tree.frame_drift(tree.forward(root, positions), velocities, frame)
    torch.testing.assert_close(drift, expected, atol=1e-6, rtol=1e-6)


def test_columns_are_chosen_and_others_do_not_move_the_point() -> None:
    articulation = _two_slides()
    poses = KinematicTree(articulation).forward(torch.tensor([[0.0, 0, 0, 1, 0, 0, 0]]), torch.tensor([[0.01, 0.02]]))
    jacobian = PointJacobian(articulation, 2, (1, 0), torch.device("cpu"))(poses, poses[:, 2, :3])
    assert jacobian[0, :, 0].tolist() == [0.0, -1.0, 0.0, 0.0, 0.0, 0.0]
    assert not jacobian[0, :, 1].any()


def test_mimic_columns_fold_into_their_leader() -> None:
    articulation = _two_slides()
    tree = KinematicTree(articulation)
    poses = tree.forward(torch.tensor([[0.0, 0, 0, 1, 0, 0, 0]]), torch.zeros(1, 2))
    folded = tree.jacobian(poses, "finger1")[0].numpy() @ mimic_matrix(articulation)
    np.testing.assert_allclose(folded[:3], [[0, 0], [-2, 0], [0, 0]])


def test_no_joints_give_no_columns() -> None:
    tree = KinematicTree(Articulation("box", (Link("box", 1.0),)))
    poses = tree.forward(torch.tensor([[1.0, 2, 3, 1, 0, 0, 0]]), torch.zeros(1, 0))
    assert tree.jacobian(poses, "box").shape == (1, 6, 0)
    assert tree.link_velocities(poses, torch.ones(1, 6), torch.zeros(1, 0)).tolist() == [[[1.0] * 6]]


def test_unknown_frame_names_the_culprit() -> None:
    tree = KinematicTree(_two_slides())
    with pytest.raises(UnknownNameError, match="finger7"):
        tree.jacobian(torch.zeros(1, 3, 7), "finger7")
