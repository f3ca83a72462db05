"""Compound joints are chains of simple ones that reach what the joint reaches, with links between without mass."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch

from orbit_assets.joint_models import BALL, FLOATING, PLANAR, Freedom, chain, compound
from orbit_core.dynamics.kinematics import KinematicTree
from orbit_core.dynamics.transforms import quat_distance
from orbit_core.interfaces.errors import AssetError
from orbit_core.preparation.validation import validate
from orbit_core.scene import Articulation, Joint, JointType, Link, Pose, Shape, Sphere

INERTIA = np.diag([0.01, 0.02, 0.02])
HIP = Joint(
    "hip",
    JointType.CONTINUOUS,
    "base",
    "leg",
    parent_pose=Pose.from_euler(0.3, -0.2, 0.9, (0.1, 0.2, 0.3)),
    child_pose=Pose.from_euler(-0.5, 0.1, 0.4, (0.0, -0.1, 0.2)),
    damping=0.7,
    armature=0.0,
)


def jointed(freedoms: tuple[Freedom, ...]) -> Articulation:
    links, joints = compound(HIP, freedoms)
    return Articulation("walker", (Link("base"), *links, Link("leg", 1.0, inertia=INERTIA)), joints)


def leg_pose(articulation: Articulation, positions: list[float]) -> torch.Tensor:
    root = torch.tensor([[0.0, 0, 0, 1, 0, 0, 0]])
    return KinematicTree(articulation).forward(root, torch.tensor([positions]))[0, -1]


def assert_same(got: torch.Tensor, asked: Pose) -> None:
    assert got[:3].tolist() == pytest.approx(asked.position, abs=1e-6)
    assert float(quat_distance(got[3:], torch.tensor(asked.orientation))) < 1e-3


def test_a_ball_joint_turns_about_x_then_y_then_z_of_its_frame() -> None:
    articulation = validate(jointed(BALL))
    assert articulation.joint_names == ("hip_rx", "hip_ry", "hip_rz")
    turned = Pose.from_axis_angle((1.0, 0.0, 0.0), 0.4) @ Pose.from_axis_angle((0.0, 1.0, 0.0), -0.8)
    turned = turned @ Pose.from_axis_angle((0.0, 0.0, 1.0), 1.1)
    assert_same(leg_pose(articulation, [0.4, -0.8, 1.1]), HIP.parent_pose @ turned @ HIP.child_pose.inverse())


def test_a_floating_joint_moves_and_turns() -> None:
    moved = Pose((0.1, 0.2, -0.3)) @ Pose.from_axis_angle((1.0, 0.0, 0.0), 0.5)
    asked = HIP.parent_pose @ moved @ HIP.child_pose.inverse()
    assert_same(leg_pose(validate(jointed(FLOATING)), [0.1, 0.2, -0.3, 0.5, 0.0, 0.0]), asked)


def test_a_planar_joint_stays_in_its_plane() -> None:
    moved = Pose.from_axis_angle((0.0, 0.0, 1.0), 0.5, (0.1, 0.2, 0.0))
    assert_same(
        leg_pose(validate(jointed(PLANAR)), [0.1, 0.2, 0.5]), HIP.parent_pose @ moved @ HIP.child_pose.inverse()
    )


def test_links_between_weigh_nothing_and_joints_keep_what_the_joint_says() -> None:
    articulation = jointed(BALL)
    assert [link.name for link in articulation.links] == ["base", "hip_rx_link", "hip_ry_link", "leg"]
    assert [link.mass for link in articulation.links] == [0.0, 0.0, 0.0, 1.0]
    assert [joint.damping for joint in articulation.joints] == [0.7, 0.7, 0.7]


def test_links_that_a_compound_joint_connects_count_as_joined() -> None:
    assert ("base", "leg") in jointed(BALL).joined_links
    shaped = jointed(BALL)
    ring = replace(shaped.links[2], collisions=(Shape(Sphere(0.1)),))
    shaped = replace(shaped, links=(*shaped.links[:2], ring, shaped.links[3]))
    assert {pair for pair in shaped.joined_links if "leg" in pair} == {(ring.name, "leg")}


def test_no_freedom_is_a_fixed_joint() -> None:
    links, joints = compound(HIP, ())
    assert links == ()
    assert joints == (replace(HIP, type=JointType.FIXED),)


def test_joints_with_anchors_of_their_own_act_one_after_another() -> None:
    first = Joint("a", JointType.REVOLUTE, "base", "leg", Pose((0.0, 0.0, 1.0)), Pose((0.0, 0.0, 0.0)), (1.0, 0.0, 0.0))
    second = Joint(
        "b", JointType.REVOLUTE, "base", "leg", Pose((0.0, 0.0, 0.8)), Pose((0.0, 0.0, -0.2)), (0.0, 1.0, 0.0)
    )
    links, joints = chain([first, second])
    articulation = validate(Articulation("leg", (Link("base"), *links, Link("leg", 1.0, inertia=INERTIA)), joints))
    assert_same(leg_pose(articulation, [0.0, 0.0]), Pose((0.0, 0.0, 1.0)))
    about_first = Pose((0.0, 0.0, 1.0)) @ Pose.from_axis_angle((1.0, 0.0, 0.0), 0.3)
    about_second = Pose((0.0, 0.0, -0.2)) @ Pose.from_axis_angle((0.0, 1.0, 0.0), 0.6) @ Pose((0.0, 0.0, 0.2))
    assert_same(leg_pose(articulation, [0.3, 0.6]), about_first @ about_second)


@pytest.mark.parametrize(
    ("freedoms", "message"),
    [
        ((BALL[0], replace(BALL[0], suffix="again")), "joints 'hip_rx', 'hip_again' move link 'leg' in the same way"),
        ((*FLOATING, replace(BALL[2], suffix="again")), "in the same way"),
    ],
)
def test_joints_that_move_a_link_in_the_same_way_are_refused(freedoms: tuple[Freedom, ...], message: str) -> None:
    with pytest.raises(AssetError, match=message):
        validate(jointed(freedoms))


def test_armature_makes_joints_that_move_a_link_in_the_same_way_sound() -> None:
    articulation = jointed((BALL[0], replace(BALL[0], suffix="again")))
    first, second = articulation.joints
    validate(replace(articulation, joints=(first, replace(second, armature=0.1))))
