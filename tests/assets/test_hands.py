"""Dexterous hands of the catalogue are whole by themselves, close along y and hold what they close on."""

from __future__ import annotations

import math

import pytest
import torch
from torch import Tensor

from orbit_assets.catalogue import robot
from orbit_assets.objects import cylinder
from orbit_assets.sources import installed_urdf
from orbit_core.actions import BinaryGripperConfig, JointTarget, joint_commands
from orbit_core.backends import default_backend
from orbit_core.dynamics.kinematics import KinematicTree
from orbit_core.envs import make
from orbit_core.interfaces import ConfigurationError
from orbit_core.interfaces.names import match_names
from orbit_core.preparation.validation import validate_entity
from orbit_core.scene import Pose, RobotSpec, Scene
from orbit_core.world import simulate

HANDS = {"allegro_left": 16, "allegro_right": 16, "dex3_left": 7, "dex3_right": 7, "shadow_hand": 20}
"""Driven joints by name."""


def tips(spec: RobotSpec, opened: bool) -> Tensor:
    """(T, 3) of the finger tips in the end effector's frame, the thumb's among them, with the hand open or closed."""
    articulation, effector = spec.articulation, spec.end_effector
    gripper = effector.gripper
    assert gripper is not None
    ends = gripper.open_position if opened else gripper.closed_position
    assert isinstance(ends, tuple)
    positions = torch.zeros(1, len(articulation.joint_names))
    for pattern, value in zip(gripper.joints, ends, strict=True):
        positions[:, match_names((pattern,), articulation.joint_names, "joint")] = value
    for index, joint in enumerate(articulation.movable_joints):
        if joint.mimic:
            positions[:, index] = joint.mimic.position(positions[:, articulation.joint_names.index(joint.mimic.joint)])
    tree = KinematicTree(articulation)
    links = tree.forward(torch.tensor([[0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0]]), positions)
    center = tree.frame_pose(links, effector.frame)
    # The frame's axes are the root's at home.
    torch.testing.assert_close(center[0, 3:], torch.tensor([1.0, 0.0, 0.0, 0.0]), atol=1e-5, rtol=0.0)
    return torch.cat([tree.frame_pose(links, tip)[:, :3] for tip in effector.finger_tips]) - center[:, :3]


@pytest.mark.parametrize("name", HANDS)
def test_a_hand_is_a_robot_of_its_own(name: str) -> None:
    spec = robot(name)
    validate_entity(spec)
    driven = [joint for joint in spec.articulation.movable_joints if joint.mimic is None]
    assert len(driven) == HANDS[name]
    assert all(math.isfinite(joint.effort_limit) and joint.armature > 0 for joint in driven)
    assert not spec.has_arm
    assert len(joint_commands(spec).joints) == HANDS[name]
    assert spec.licence
    assert len(spec.end_effector.finger_tips) in (3, 4, 5)


@pytest.mark.parametrize("name", HANDS)
def test_thumb_and_fingers_close_along_y_at_the_frame(name: str) -> None:
    spec = robot(name)
    thumb = [index for index, tip in enumerate(spec.end_effector.finger_tips) if tip in ("link_15.0_tip", "S_thtip")
             or "thumb" in tip]  # fmt: skip
    fingers = [index for index in range(len(spec.end_effector.finger_tips)) if index not in thumb]
    opened, closed = tips(spec, opened=True), tips(spec, opened=False)
    assert len(thumb) == 1
    gaps = [float(tip[fingers[:2], 1].min() - tip[thumb, 1]) for tip in (opened, closed)]
    assert 0.08 < gaps[0] < 0.15
    assert -0.02 < gaps[1] < 0.045
    assert (opened[thumb, 1] < -0.03).all()
    assert (opened[fingers, 1] > 0.03).all()
    for pose in (opened, closed):
        assert (pose[:, 2].abs() < 0.03).all(), "the tips are level with the frame"
    assert abs(opened[thumb, 0] - opened[fingers[:2], 0].mean()) < 0.02, "the thumb is opposite the first fingers"


@pytest.mark.parametrize("hand", ["allegro", "dex3"])
@pytest.mark.parametrize("opened", [True, False])
def test_left_and_right_hands_are_mirror_images(hand: str, opened: bool) -> None:
    left, right = (tips(robot(f"{hand}_{side}"), opened) for side in ("left", "right"))
    mirrored = right * torch.tensor([-1.0, 1.0, 1.0])
    distance = torch.cdist(left, mirrored).min(dim=1).values
    assert distance.max() < 1e-4


def test_masses_are_the_files() -> None:
    for name, mass in (("shadow_hand", 5.011), ("allegro_right", 0.9549)):
        assert robot(name).articulation.mass == pytest.approx(mass, rel=1e-5)
    body = installed_urdf("example-robot-data", "robots/g1_description/urdf/g1_29dof_with_hand_rev_1_0.urdf")
    own = sum(link.mass for link in body.links if link.name.startswith("left_hand_"))
    assert robot("dex3_left").articulation.mass == pytest.approx(own, rel=1e-9)


def test_the_last_joints_of_the_shadow_hands_fingers_follow_by_the_tendons_arms() -> None:
    joints = {joint.name: joint for joint in robot("shadow_hand").articulation.movable_joints}
    for finger in ("FF", "MF", "RF", "LF"):
        follower, leader = joints[f"{finger}J0"], joints[f"{finger}J1"]
        assert follower.mimic is not None
        assert follower.mimic.joint == leader.name
        assert follower.mimic.multiplier == pytest.approx(0.00805 / 0.00705)
        assert follower.mimic.multiplier * leader.upper_limit == pytest.approx(follower.upper_limit)


@pytest.mark.parametrize("name", ["allegro_left", "allegro_right", "dex3_left", "shadow_hand"])
def test_a_closed_hand_holds_a_cylinder_against_twice_its_weight_from_every_side(name: str) -> None:
    mass, seconds = 0.1, 1.5
    spec = robot(name, name="robot", pose=Pose.from_euler(0.0, math.pi / 2, 0.0, (0.0, 0.0, 0.5)))  # palm sideways
    can = cylinder("can", radius=0.02, length=0.12, mass=mass)
    world = simulate(Scene(robots=(spec,), objects=(can,)), num_envs=6, backend=default_backend())
    hand, held = world.robots["robot"], world.objects["can"]
    frame = hand.frame_pose(spec.end_effector.frame).clone()  # x points down, z ahead
    upright = torch.tensor([1.0, 0.0, 0.0, 0.0]).expand(6, 4)
    held.set_root_pose(torch.cat((frame[:, :3], upright), dim=1))
    gripper = BinaryGripperConfig().build("gripper", hand)
    opened, closed = (
        gripper.compute({"command": torch.full((6, 1), command)})[JointTarget.POSITION] for command in (1.0, -1.0)
    )
    weight = torch.tensor([0.0, 0.0, mass * 9.81, 0.0, 0.0, 0.0])
    for step in range(200):  # the hand closes within half a second on what does not fall yet
        share = min(1.0, step / 100)
        hand.set_position_targets((1.0 - share) * opened + share * closed, gripper.joints)
        held.set_wrenches(weight.expand(6, 1, 6))
        world.step()
    start = held.root_pose[:, :3].clone()
    pull = torch.cat((torch.eye(3), -torch.eye(3))) * 2.0 * mass * 9.81
    for _ in range(round(seconds / world.physics_dt)):
        held.set_wrenches(torch.cat((pull, torch.zeros(6, 3)), dim=1)[:, None])
        world.step()
    moved = (held.root_pose[:, :3] - start).norm(dim=1)
    world.close()
    assert moved.max() < 0.02


@pytest.mark.parametrize("task", ["Reach", "Lift"])
def test_a_task_for_arms_says_what_a_hand_lacks(task: str) -> None:
    with pytest.raises(ConfigurationError, match=r"'allegro_right' has no arm.*as in 'ur10\+allegro_right'"):
        make(task, num_envs=1, backend=default_backend(), robot="allegro_right")


def test_a_hand_on_a_base_without_an_arm_is_refused() -> None:
    with pytest.raises(ConfigurationError, match=r"unitree_a1 .base. . shadow_hand .end effector.: allowed are"):
        robot("unitree_a1+shadow_hand")


@pytest.mark.parametrize("name", ["franka_panda_allegro", "ur10_shadow_hand"])
def test_an_arm_with_a_hand_is_in_the_catalogue_and_grips_by_every_joint_of_the_hand(name: str) -> None:
    spec = robot(name)
    validate_entity(spec)
    assert spec.has_arm
    gripper = BinaryGripperConfig()
    assert gripper.gripper_of(spec).joints
    moved = {spec.articulation.joint_names[joint] for joint in gripper.joint_indices(spec, "gripper")}
    arm = match_names(spec.end_effector.arm_joints, spec.articulation.joint_names, "joint")
    assert moved.isdisjoint(spec.articulation.joint_names[joint] for joint in arm)
    assert len(moved) in (13, 16)
