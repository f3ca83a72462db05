"""Mass matrix and forces of random trees and of catalogue robots against MuJoCo's, and laws that hold for any tree."""

from __future__ import annotations

import importlib.util
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from orbit_assets import load_articulation
from orbit_assets.audit.checks import posture
from orbit_assets.audit.mjcf_reference import MujocoReference
from orbit_assets.catalogue import robot
from orbit_assets.options import ReadOptions, Unsupported
from orbit_core.dynamics.rigid_body import RigidBodyModel
from orbit_core.preparation.merge import merge_fixed_links
from orbit_core.scene import Articulation, Joint, JointType, Link, Pose

Build = Callable[[Articulation, bool], Any]
seeds = st.integers(0, 2**32 - 1)


def _check_dynamics(reference: Any, seed: int) -> None:
    model = RigidBodyModel(reference.articulation, fixed_base=not reference.floating)
    reference.set_random_state(np.random.default_rng(seed))
    poses, root, joints = reference.link_poses, reference.link_velocities[:, 0], reference.joint_velocities
    expected = reference.mass_matrix()
    size = max(1.0, np.abs(expected).max(initial=0.0))
    np.testing.assert_allclose(model.mass_matrix(poses)[0].numpy() / size, expected / size, atol=1e-5)
    bias = reference.bias_forces()
    size = max(1.0, np.abs(bias).max(initial=0.0))
    np.testing.assert_allclose(model.bias_forces(poses, root, joints)[0].numpy() / size, bias / size, atol=1e-5)
    at_rest = model.bias_forces(poses, torch.zeros_like(root), torch.zeros_like(joints))
    torch.testing.assert_close(model.gravity_forces(poses), at_rest, atol=1e-3, rtol=1e-5)


@pytest.mark.parametrize("floating", [False, True])
@given(seed=seeds)
@settings(max_examples=30, deadline=None)
def test_random_trees_agree_with_mujoco(
    build_reference: Build, random_tree: Callable[[int], Articulation], floating: bool, seed: int
) -> None:
    _check_dynamics(build_reference(random_tree(seed), floating), seed)


@pytest.mark.parametrize(("name", "floating"), [("franka_panda", False), ("anymal_c", True)])
def test_robots_agree_with_mujoco(build_reference: Build, name: str, floating: bool) -> None:
    reference = build_reference(merge_fixed_links(robot(name).articulation), floating)
    for seed in range(3):
        _check_dynamics(reference, seed)


@given(seed=seeds, floating=st.booleans())
@settings(max_examples=30, deadline=None)
def test_mass_matrix_is_symmetric_and_gives_the_kinetic_energy(
    random_tree: Callable[[int], Articulation], seed: int, floating: bool
) -> None:
    articulation = random_tree(seed)
    model = RigidBodyModel(articulation, not floating, armature=[0.0] * len(articulation.joint_names))
    root_pose, positions, root_velocity, velocities = _random_state(articulation, seed, floating)
    poses = model.kinematics.forward(root_pose, positions)
    mass = model.mass_matrix(poses)
    torch.testing.assert_close(mass, mass.transpose(1, 2))
    speeds = torch.cat((root_velocity, velocities), -1) if floating else velocities
    energy = 0.5 * torch.einsum("ni,nij,nj->n", speeds, mass, speeds)
    links = model.kinematics.link_velocities(poses, root_velocity, velocities)
    expected = sum(_link_energy(link, poses[:, i], links[:, i]) for i, link in enumerate(articulation.links))
    torch.testing.assert_close(energy, torch.as_tensor(expected), atol=1e-4, rtol=1e-4)


@given(seed=seeds)
@settings(max_examples=20, deadline=None)
def test_free_motion_without_gravity_keeps_its_energy(random_tree: Callable[[int], Articulation], seed: int) -> None:
    articulation = random_tree(seed)
    if not articulation.joint_names:
        return
    model = RigidBodyModel(articulation, fixed_base=True, gravity=(0.0, 0.0, 0.0))
    root_pose, q, _, v = _random_state(articulation, seed, floating=False)
    poses = model.kinematics.forward(root_pose, q)
    bias = model.bias_forces(poses, torch.zeros(4, 6), v)
    acceleration = -torch.linalg.solve(model.mass_matrix(poses), bias)
    step = 1e-2
    energies = []
    for sign in (-1, 1):
        later = q + sign * step * v + 0.5 * step**2 * acceleration
        speeds = v + sign * step * acceleration
        mass = model.mass_matrix(model.kinematics.forward(root_pose, later))
        energies.append(0.5 * torch.einsum("ni,nij,nj->n", speeds, mass, speeds))
    scale = energies[0] * (1.0 + acceleration.abs().amax(-1)) * (1.0 + v.abs().amax(-1)) ** 2
    assert ((energies[1] - energies[0]).abs() / (2 * step) < 5e-3 * scale).all()


def test_pendulum_has_its_closed_form() -> None:
    length, mass, inertia = 0.7, 1.3, 0.02
    bob = Link("bob", mass, (0.0, 0.0, -length), inertia * np.eye(3))
    hinge = Joint("hinge", JointType.CONTINUOUS, "base", "bob", Pose((1.0, 2.0, 3.0)), axis=(0, 1, 0), armature=0.1)
    model = RigidBodyModel(Articulation("pendulum", (Link("base"), bob), (hinge,)), fixed_base=True)
    angle = torch.tensor([[0.4], [-1.2]])
    poses = model.kinematics.forward(torch.tensor([[0.0, 0, 0, 1, 0, 0, 0]]).repeat(2, 1), angle)
    torch.testing.assert_close(model.mass_matrix(poses), torch.full((2, 1, 1), mass * length**2 + inertia + 0.1))
    torch.testing.assert_close(model.gravity_forces(poses), mass * 9.81 * length * angle.sin())


def test_double_precision_keeps_what_single_precision_loses_of_small_fingers() -> None:
    """Far from the root, a finger's moment is the small difference of large ones."""
    inertia = 1e-6
    links = (Link("base"), Link("hand", 1.0, inertia=0.01 * np.eye(3)), Link("tip", 1e-3, inertia=inertia * np.eye(3)))
    joints = (
        Joint("arm", JointType.CONTINUOUS, "base", "hand"),
        Joint("finger", JointType.CONTINUOUS, "hand", "tip", Pose((3.0, 2.0, 1.0)), axis=(0.0, 1.0, 0.0)),
    )
    articulation = Articulation("hand", links, joints)
    errors = {}
    for dtype in (torch.float32, torch.float64):
        model = RigidBodyModel(articulation, True, dtype=dtype)
        root = torch.tensor([[0.1, 0.2, 0.3, 1.0, 0.0, 0.0, 0.0]], dtype=dtype)
        poses = model.kinematics.forward(root, torch.tensor([[0.3, 0.2]], dtype=dtype))
        mass = model.mass_matrix(poses)
        assert mass.dtype is poses.dtype is model.gravity_forces(poses).dtype is dtype
        errors[dtype] = abs(float(mass[0, 1, 1]) / inertia - 1.0)
    assert errors[torch.float64] < 1e-8
    assert errors[torch.float32] > 1e-5


def _random_state(articulation: Articulation, seed: int, floating: bool) -> tuple[torch.Tensor, ...]:
    generator = torch.Generator().manual_seed(seed)
    joints = len(articulation.joint_names)
    root_pose = torch.randn(4, 7, generator=generator)
    root_pose[:, 3:] /= root_pose[:, 3:].norm(dim=-1, keepdim=True)
    root_velocity = torch.randn(4, 6, generator=generator) * floating
    positions, velocities = torch.randn(2, 4, joints, generator=generator)
    return root_pose, positions, root_velocity, velocities


def _link_energy(link: Link, pose: torch.Tensor, velocity: torch.Tensor) -> torch.Tensor:
    energies = []
    for row in range(len(pose)):
        position, quaternion = pose[row, :3].tolist(), pose[row, 3:].tolist()
        rotation = Pose(tuple(position), tuple(quaternion)).rotation_matrix()
        linear, angular = velocity[row, :3].numpy(), velocity[row, 3:].numpy()
        center = linear + np.cross(angular, rotation @ np.asarray(link.center_of_mass))
        local = rotation.T @ angular
        energies.append(0.5 * link.mass * center @ center + 0.5 * local @ link.inertia @ local)
    return torch.tensor(energies, dtype=torch.float32)


def test_in_double_precision_a_shadow_hands_mass_matrix_is_the_compilers() -> None:
    robotics = importlib.util.find_spec("gymnasium_robotics")
    if robotics is None or robotics.origin is None:
        pytest.skip("the package gymnasium-robotics, which has the Shadow hand, is not installed")
    path = Path(robotics.origin).parent / "envs" / "assets" / "hand" / "reach.xml"
    options = ReadOptions(unsupported=Unsupported.DROP, articulation="robot0:hand mount", allow_outside=True)
    hand = load_articulation(path, merge=False, options=options)
    names = tuple(joint.name for joint in hand.movable_joints)
    positions = dict.fromkeys(names, 0.3)
    reference = MujocoReference(path, hand.root.name)
    reference.move(positions, posture(hand, positions))
    expected = reference.mass_matrix(names)
    model = RigidBodyModel(hand, fixed_base=True, dtype=torch.float64)
    root = torch.tensor([[0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0]], dtype=torch.float64)
    poses = model.kinematics.forward(root, torch.full((1, len(names)), 0.3, dtype=torch.float64))
    size = np.sqrt(np.outer(np.diag(expected), np.diag(expected)))
    assert len(names) == 24
    np.testing.assert_allclose(model.mass_matrix(poses)[0].numpy() / size, expected / size, atol=1e-5)
