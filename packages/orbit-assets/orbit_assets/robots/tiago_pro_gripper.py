"""The gripper of PAL Robotics' TIAGo Pro, with two parallel jaws."""

from __future__ import annotations

from dataclasses import replace

from orbit_assets.cache import Model
from orbit_assets.compose import add_frames, edit_joints, edit_links, simplify_collisions, subtree
from orbit_assets.installed import installed_urdf
from orbit_assets.parts import PartKind, RobotPart
from orbit_assets.robots.tiago_pro import FILE, LICENCE, SOURCE, arm
from orbit_core.preparation.merge import merge_fixed_links
from orbit_core.scene import Articulation, Box, Frame, Gripper, ImplicitPd, Link, Pose, Shape

FINGER = "gripper_left_finger_joint"


def gripper() -> Articulation:
    """The gripper with two parallel jaws, open by 79 mm; the frame ``gripper_left_tcp`` lies between the pads."""
    hand = merge_fixed_links(subtree(installed_urdf(SOURCE, FILE), "gripper_left_base_link", "tiago_pro_gripper"))
    hand = add_frames(hand, Frame("gripper_left_tcp", "gripper_left_base_link", Pose((0.0, 0.0, 0.155))))
    note = "TIAGo Pro's finger tips collide as one box each, so that flat pads meet what they hold"
    hand = edit_links(simplify_collisions(hand), ("gripper_left_fingertip_.*_link",), note, _boxed_tip)
    note = "effort limit of 2 N m on TIAGo Pro's gripper, some 20 N at each pad: with the URDF's 0.1 N m it holds 50 g"
    hand = edit_joints(hand, (".*",), note, effort_limit=2.0)
    note = "armature of 0.002 kg m^2 on TIAGo Pro's gripper is the catalogue's choice: its links weigh 30 g"
    return edit_joints(hand, (".*",), note, armature=0.002)


def _boxed_tip(link: Link) -> Link:
    return replace(link, collisions=(Shape(Box((0.005, 0.02, 0.0125)), Pose((-0.0065, 0.027, 0.0)), name="pad"),))


PART = RobotPart(
    name="tiago_pro_gripper",
    kind=PartKind.END_EFFECTOR,
    model=Model("tiago_pro_gripper", gripper, (SOURCE,), LICENCE, parts=(arm,)),
    drives=(ImplicitPd(joints=(FINGER,), stiffness=20.0, damping=1.0),),
    frame="gripper_left_tcp",
    gripper=Gripper((FINGER,), 0.0, 0.8),
)
