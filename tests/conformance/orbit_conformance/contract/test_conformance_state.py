"""Poses and velocities: order, frames, units, and writes that the next read sees. Single precision: 1e-5."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest
import torch
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from orbit_conformance.bodies import WEIGHTLESS, ball, body, cube, index, pendulum, rotor, scene, tree, yaw_quaternion
from orbit_conformance.contract.fixtures import MakeEngine, assert_near
from orbit_core.scene import Articulation, Joint, JointType, Link, Pose, RobotSpec
from orbit_core.world.checks import check_build

EXACT = {"rtol": 1e-5, "atol": 1e-5}


def test_shapes_and_dtypes(make_engine: MakeEngine) -> None:
    engine = make_engine(scene(tree(), cube()), num_envs=3)
    engine.step(1)
    shapes = {
        "joint_positions": (3, 4), "joint_velocities": (3, 4), "joint_efforts": (3, 4),
        "link_poses": (3, 6, 7), "link_velocities": (3, 6, 6),
    }  # fmt: skip
    for name, shape in shapes.items():
        assert getattr(engine, name).shape == shape
        assert getattr(engine, name).dtype == torch.float32


def test_initial_state_is_the_scenes(make_engine: MakeEngine) -> None:
    engine = make_engine(scene(pendulum(home=0.4), cube(pose=Pose((1.0, 2.0, 3.0), (0.0, 0.0, 0.0, 1.0)))), num_envs=2)
    assert_near(engine.joint_positions, torch.tensor([[0.4, 0.0]] * 2), **EXACT)
    assert_near(engine.position_targets, torch.tensor([[0.4, 0.0]] * 2), **EXACT)
    expected = torch.tensor([1.0, 2.0, 3.0, 0.0, 0.0, 0.0, 1.0])
    assert_near(engine.link_poses[1, -1], expected, **EXACT)
    assert engine.link_velocities.abs().max() == 0


def test_order_is_the_descriptions_and_not_depth_first(make_engine: MakeEngine) -> None:
    engine = make_engine(scene(tree()))
    positions = torch.tensor([[0.1, 0.2, 0.3, 0.4]])
    engine.write_joint_state(index(0, 1, 2, 3), positions, None)
    assert_near(engine.joint_positions, positions, **EXACT)
    poses = engine.link_poses[0]
    assert_near(poses[1], torch.tensor([0.0, 0.1, 1.0, *yaw_quaternion(0.1)]), **EXACT)
    assert_near(poses[2], torch.tensor([0.0, -0.1, 1.0, *yaw_quaternion(0.2)]), **EXACT)
    left = torch.tensor([0.3 * math.cos(0.1), 0.1 + 0.3 * math.sin(0.1), 1.0, *yaw_quaternion(0.4)])
    right = torch.tensor([0.4 * math.cos(0.2), -0.1 + 0.4 * math.sin(0.2), 1.0, *yaw_quaternion(0.6)])
    assert_near(poses[3], left, **EXACT)
    assert_near(poses[4], right, **EXACT)


@settings(max_examples=20, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(a=st.floats(-3, 3), b=st.floats(-3, 3), u=st.floats(-2, 2), v=st.floats(-2, 2))
def test_kinematics_of_two_links(make_engine: MakeEngine, a: float, b: float, u: float, v: float) -> None:
    """Rotation about y by q takes x to (cos q, 0, -sin q)."""
    engine = make_engine(scene(pendulum(length=0.5)))
    engine.write_joint_state(index(0, 1), torch.tensor([[a, b]]), torch.tensor([[u, v]]))
    elbow = torch.tensor([0.5 * math.cos(a), 0.0, 2.0 - 0.5 * math.sin(a)])
    assert_near(engine.link_poses[0, 2, :3], elbow, **EXACT)
    velocity = torch.tensor([-0.5 * math.sin(a) * u, 0.0, -0.5 * math.cos(a) * u, 0.0, u + v, 0.0])
    assert_near(engine.link_velocities[0, 2], velocity, rtol=1e-5, atol=2e-5)


def test_frames_of_a_joint_with_poses_on_both_sides(make_engine: MakeEngine) -> None:
    """The joint moves the child's frame about the joint's axis: ``parent_pose R(q) child_pose^-1``."""
    parent_pose = Pose.from_euler(0.3, -0.2, 0.5, (0.1, 0.2, 0.3))
    child_pose = Pose.from_euler(-0.4, 0.1, 0.2, (0.05, -0.1, 0.02))
    axis = (0.6, 0.0, 0.8)
    joint = Joint("j", JointType.CONTINUOUS, "base", "arm", parent_pose, child_pose, axis)
    base = Pose.from_euler(0.1, 0.2, 0.3, (0.0, 0.0, 1.0))
    articulation = Articulation("hand", (body("base"), body("arm")), (joint,))
    engine = make_engine(scene(RobotSpec(name="hand", articulation=articulation, fixed_base=True, pose=base)))
    engine.write_joint_state(index(0), torch.tensor([[0.7]]), None)
    expected = base @ parent_pose @ Pose.from_axis_angle(axis, 0.7) @ child_pose.inverse()
    assert_near(engine.link_poses[0, 1], torch.tensor([*expected.position, *expected.orientation]), **EXACT)


def test_fixed_joints_carry_their_links_along(make_engine: MakeEngine) -> None:
    joints = (
        Joint("turn", JointType.CONTINUOUS, "base", "arm"),
        Joint("weld", JointType.FIXED, "arm", "tool", parent_pose=Pose((0.2, 0.0, 0.0))),
    )
    articulation = Articulation("arm", (body("base"), body("arm"), body("tool")), joints)
    engine = make_engine(scene(RobotSpec(name="arm", articulation=articulation, fixed_base=True)))
    engine.write_joint_state(index(0), torch.tensor([[math.pi / 2]]), torch.tensor([[2.0]]))
    assert_near(engine.link_poses[0, 2, :3], torch.tensor([0.0, 0.2, 0.0]), **EXACT)
    assert_near(engine.link_velocities[0, 2], torch.tensor([-0.4, 0, 0, 0, 0, 2.0]), **EXACT)


def test_velocity_is_of_the_origin_in_world_axes_linear_first(make_engine: MakeEngine) -> None:
    """A body with its centre of mass aside, yawed by 90 degrees: what is written is what is read, and what moves."""
    engine = make_engine(scene(cube(center_of_mass=(0.1, 0.0, 0.0)), gravity=WEIGHTLESS, dt=0.001))
    pose = torch.tensor([[0.0, 0.0, 1.0, *yaw_quaternion(math.pi / 2)]])
    velocity = torch.tensor([[0.3, -0.2, 0.1, 0.5, 0.0, 2.0]])
    engine.write_root_state(0, pose, velocity)
    assert_near(engine.link_velocities[:, 0], velocity, **EXACT)
    before = engine.link_poses[0, 0].clone()
    engine.step(1)
    moved = (engine.link_poses[0, 0, :3] - before[:3]) / 0.001
    # Motion over a short step shows whether the written velocity is that of the origin or of the centre of mass.
    assert_near(moved, velocity[0, :3], rtol=0, atol=5e-3)  # one step of explicit integration
    omega = engine.link_velocities[0, 0, 3:]
    assert_near(omega, velocity[0, 3:], rtol=0, atol=5e-3)


def test_a_spinning_body_circles_its_centre_of_mass(make_engine: MakeEngine) -> None:
    """Origin velocity ``omega x (origin - com)``: after half a turn the origin has gone to the other side."""
    engine = make_engine(scene(cube(center_of_mass=(0.1, 0.0, 0.0)), gravity=WEIGHTLESS, dt=0.001))
    pose = torch.tensor([[0.0, 0.0, 1.0, 1.0, 0.0, 0.0, 0.0]])
    engine.write_root_state(0, pose, torch.tensor([[0.0, -0.1 * math.pi, 0.0, 0.0, 0.0, math.pi]]))
    engine.step(1000)
    assert_near(engine.link_poses[0, 0, :3], torch.tensor([0.2, 0.0, 1.0]), rtol=0, atol=2e-3)


def test_a_new_pose_keeps_the_velocity(make_engine: MakeEngine) -> None:
    engine = make_engine(scene(cube(), gravity=WEIGHTLESS))
    velocity = torch.tensor([[0.1, 0.2, 0.3, 0.4, 0.5, 0.6]])
    engine.write_root_state(0, None, velocity)
    engine.write_root_state(0, torch.tensor([[0.0, 0.0, 1.0, *yaw_quaternion(1.0)]]), None)
    assert_near(engine.link_velocities[:, 0], velocity, **EXACT)


@settings(max_examples=15, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(q=st.lists(st.floats(-1, 1), min_size=4, max_size=4).filter(lambda q: sum(x * x for x in q) > 0.1))
def test_quaternions_are_unit_with_a_positive_real_part(make_engine: MakeEngine, q: list[float]) -> None:
    engine = make_engine(scene(ball(), gravity=WEIGHTLESS))
    orientation = torch.tensor(q) / torch.tensor(q).norm()
    engine.write_root_state(0, torch.cat((torch.tensor([0.0, 0.0, 1.0]), orientation))[None], None)
    read = engine.link_poses[0, 0, 3:]
    assert read[0] >= 0
    assert read.norm() == pytest.approx(1, abs=1e-5)
    assert (read * orientation).sum().abs() == pytest.approx(1, abs=1e-5)


def test_writes_reach_only_the_environments_named(make_engine: MakeEngine) -> None:
    engine = make_engine(scene(pendulum(), cube()), num_envs=4)
    before = engine.link_poses.clone()
    # Environments out of order: rows belong to the order given, not to the sorted one.
    engine.write_joint_state(index(1), torch.tensor([[0.5], [0.6]]), None, index(3, 1))
    engine.write_root_state(1, torch.tensor([[0.0, 1.0, 2.0, 1.0, 0.0, 0.0, 0.0]]), None, index(2))
    assert_near(engine.joint_positions[:, 1], torch.tensor([0.0, 0.6, 0.0, 0.5]), **EXACT)
    assert engine.link_poses[2, -1, :3].tolist() == [0.0, 1.0, 2.0]
    assert torch.equal(engine.link_poses[0], before[0])
    assert torch.equal(engine.link_poses[[0, 1, 3], -1], before[[0, 1, 3], -1])


def test_joints_are_written_in_the_order_given(make_engine: MakeEngine) -> None:
    engine = make_engine(scene(tree(), terrain=()), num_envs=2)
    engine.write_joint_state(index(3, 1), torch.tensor([[0.3, 0.1]]), torch.tensor([[3.0, 1.0]]), index(1))
    truth = torch.tensor([[0.0, 0.0, 0.0, 0.0], [0.0, 0.1, 0.0, 0.3]])
    assert_near(engine.joint_positions, truth, **EXACT)
    assert_near(engine.joint_velocities, 10.0 * truth, **EXACT)


def test_a_fixed_base_moves_when_told_in_its_environment_alone(make_engine: MakeEngine) -> None:
    """Links follow the base in its environment only: at once, after steps and after its reset."""
    engine = make_engine(scene(pendulum(), terrain=(), gravity=WEIGHTLESS), num_envs=3)
    home = engine.link_poses.clone()
    pose = torch.tensor([[1.0, 2.0, 3.0, *yaw_quaternion(math.pi / 2)]])
    engine.write_root_state(0, pose, None, index(1))
    for steps in (0, 5):
        engine.step(steps) if steps else None
        assert_near(engine.link_poses[1, 0], pose[0], **EXACT)
        assert_near(engine.link_poses[1, 2, :3], torch.tensor([1.0, 2.5, 3.0]), **EXACT)
        assert_near(engine.link_poses[[0, 2]], home[[0, 2]], **EXACT)
    engine.reset(index(1))
    assert_near(engine.link_poses, home, **EXACT)


def test_bases_of_several_environments_go_each_to_its_own_place(make_engine: MakeEngine) -> None:
    """Written for environments 2 and 0 in that order; 1 stays."""
    engine = make_engine(scene(pendulum(), terrain=(), gravity=WEIGHTLESS), num_envs=3)
    poses = torch.tensor([[2.0, 0.0, 1.0, 1.0, 0.0, 0.0, 0.0], [0.0, -1.0, 1.5, 1.0, 0.0, 0.0, 0.0]])
    engine.write_root_state(0, poses, None, index(2, 0))
    roots = torch.tensor([[0.0, -1.0, 1.5], [0.0, 0.0, 2.0], [2.0, 0.0, 1.0]])
    assert_near(engine.link_poses[:, 0, :3], roots, **EXACT)
    engine.step(3)
    assert_near(engine.link_poses[:, 2, :3], roots + torch.tensor([0.5, 0.0, 0.0]), **EXACT)


def test_a_robots_pose_and_home_are_set_together(make_engine: MakeEngine) -> None:
    """A turned base and a home position: where the tip's link stands is both; 1e-5."""
    turned = Pose((0.1, 0.2, 1.0), tuple(yaw_quaternion(math.pi / 2)))
    engine = make_engine(scene(pendulum(home=0.4, base=turned), terrain=()))
    truth = torch.tensor([0.1, 0.2 + 0.5 * math.cos(0.4), 1.0 - 0.5 * math.sin(0.4)])
    assert_near(engine.link_poses[0, 2, :3], truth, **EXACT)


def test_a_build_is_as_described(make_engine: MakeEngine) -> None:
    """Masses, inertias, limits, armatures and kinematics of all that the core can read back or see."""
    check_build(make_engine(scene(tree(), pendulum(), cube(center_of_mass=(0.01, 0.0, 0.0))), num_envs=2), "this")


@pytest.mark.parametrize("beyond", [0.0, 5e-4])
def test_flat_plates_are_built_as_described(make_engine: MakeEngine, beyond: float) -> None:
    """Their largest moment is the sum of the others, or more by what files round, in frames of any orientation."""
    links, joints = [Link("base", 1.0, inertia=np.eye(3))], []
    for number in range(12):
        # Moments over six decades, as files of small parts have them.
        generator = np.random.default_rng(number)
        first, second = generator.uniform(0.05, 1.0, 2) * 10.0 ** generator.uniform(-6, 0)
        axes = Pose.from_euler(*generator.uniform(-3, 3, 3)).rotation_matrix()
        tensor = axes @ np.diag((first, second, (first + second) * (1.0 + beyond))) @ axes.T
        links.append(Link(f"plate{number}", 1.0, inertia=(tensor + tensor.T) / 2.0))
        joints.append(Joint(f"j{number}", JointType.CONTINUOUS, "base", f"plate{number}"))
    articulation = Articulation("plates", tuple(links), tuple(joints))
    check_build(make_engine(scene(RobotSpec(name="plates", articulation=articulation, fixed_base=True))), "this")


def test_a_joint_without_effort_is_built(make_engine: MakeEngine) -> None:
    """URDF files describe passive joints so: ``effort="0"``."""
    robot = pendulum()
    joints = tuple(dataclasses.replace(joint, effort_limit=0.0) for joint in robot.articulation.joints)
    passive = dataclasses.replace(robot, articulation=dataclasses.replace(robot.articulation, joints=joints))
    check_build(make_engine(scene(passive)), "this")


def test_a_continuous_joint_counts_whole_turns(make_engine: MakeEngine) -> None:
    engine = make_engine(scene(rotor()))
    engine.write_joint_state(index(0), None, torch.tensor([[20.0]]))
    engine.step(200)
    assert engine.joint_positions[0, 0] == pytest.approx(20.0, rel=1e-4)
