"""Articulations attached to each other, cut apart and edited."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from orbit_assets.compose import add_frames, attach, edit_joints, edit_links, subtree
from orbit_core.interfaces.errors import AssetError, UnknownNameError
from orbit_core.preparation.merge import merge_fixed_links
from orbit_core.preparation.validation import validate
from orbit_core.scene import Articulation, DriveGains, Frame, Joint, JointType, Link, Mimic, Pose

BODY = {"mass": 1.0, "inertia": np.eye(3)}


def arm() -> Articulation:
    links = (Link("base", **BODY), Link("upper", **BODY), Link("side", **BODY))
    joints = (
        Joint("shoulder", JointType.REVOLUTE, "base", "upper"),
        Joint("elbow", JointType.REVOLUTE, "base", "side"),
    )
    return Articulation("arm", links, joints, (Frame("flange", "upper", Pose((0.0, 0.0, 0.5))),))


def hand() -> Articulation:
    links = (Link("palm", **BODY), Link("left", **BODY), Link("right", **BODY))
    joints = (
        Joint("left_joint", JointType.PRISMATIC, "palm", "left"),
        Joint("right_joint", JointType.PRISMATIC, "palm", "right", mimic=Mimic("left_joint", -1.0)),
    )
    exclusions = (("left", "right"),)
    return Articulation("hand", links, joints, (Frame("tcp", "palm"),), collision_exclusions=exclusions, notes=("n",))


def test_attach_at_a_frame() -> None:
    both = validate(attach(arm(), hand(), "flange", Pose((0.0, 0.0, 0.1)), prefix="h_"))
    assert both.link_names == ("base", "upper", "h_palm", "h_left", "h_right", "side")
    assert both.joint_names == ("shoulder", "h_left_joint", "h_right_joint", "elbow")
    assert both.joints[3].mimic == Mimic("h_left_joint", -1.0)
    assert both.collision_exclusions == (("h_left", "h_right"),)
    assert both.notes == ("n",)
    assert both.mass == pytest.approx(6.0)
    tcp = merge_fixed_links(both).frame("h_tcp")
    assert tcp.link == "upper"
    assert tcp.pose.position == pytest.approx((0.0, 0.0, 0.6))


def test_attach_twice_needs_a_prefix() -> None:
    once = attach(arm(), hand(), "flange")
    with pytest.raises(AssetError, match="share the name 'palm'"):
        attach(once, hand(), "side")
    assert len(validate(attach(once, hand(), "side", prefix="second_")).links) == 9


def test_attach_to_nothing_is_refused() -> None:
    with pytest.raises(UnknownNameError, match="did you mean 'flange'"):
        attach(arm(), hand(), "flang")


def test_subtree_undoes_attach() -> None:
    cut = validate(subtree(attach(arm(), hand(), "flange"), "palm", "hand"))
    assert (cut.name, cut.link_names, cut.joints) == ("hand", hand().link_names, hand().joints)
    assert (cut.frames, cut.collision_exclusions) == (hand().frames, hand().collision_exclusions)


def test_drives_and_home_positions_go_with_their_joints() -> None:
    drives = (DriveGains("left_joint", 10.0),)
    driven = replace(hand(), drives=drives, home=(("right_joint", -0.1),))
    both = validate(attach(arm(), driven, "flange", prefix="h_"))
    assert both.drives == (DriveGains("h_left_joint", 10.0),)
    assert both.home == (("h_right_joint", -0.1),)
    cut = validate(subtree(attach(arm(), driven, "flange"), "palm"))
    assert (cut.drives, cut.home) == (drives, driven.home)
    assert subtree(both, "side").drives == ()


def test_subtree_refuses_a_mimic_that_it_would_cut() -> None:
    joints = (
        Joint("shoulder", JointType.REVOLUTE, "base", "upper"),
        Joint("elbow", JointType.REVOLUTE, "upper", "side", mimic=Mimic("shoulder")),
    )
    chain = replace(arm(), joints=joints)
    with pytest.raises(AssetError, match="'elbow' mimics 'shoulder'"):
        subtree(chain, "upper")
    with pytest.raises(UnknownNameError, match="'nowhere'"):
        subtree(chain, "nowhere")


def test_edits_touch_what_matches_and_leave_a_note() -> None:
    edited = edit_joints(arm(), ("should.*",), "stronger", armature=0.1)
    assert [joint.armature for joint in edited.joints] == [0.1, 0.0]
    assert edited.notes == ("stronger",)
    heavier = edit_links(arm(), ("upper", "side"), "heavier", lambda link: replace(link, mass=2.0))
    assert [link.mass for link in heavier.links] == [1.0, 2.0, 2.0]
    with pytest.raises(UnknownNameError):
        edit_joints(arm(), ("nothing",), "", armature=0.1)


def test_frames_may_stand_on_frames() -> None:
    more = add_frames(arm(), Frame("tip", "flange", Pose((0.0, 0.0, 0.2))), Frame("end", "tip"))
    assert more.frame("end") == Frame("end", "upper", Pose((0.0, 0.0, 0.7)))
    with pytest.raises(AssetError, match="'tip'"):
        add_frames(more, Frame("tip", "base"))
