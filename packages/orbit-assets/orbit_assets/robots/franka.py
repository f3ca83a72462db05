"""Franka Emika Panda: the arm of seven joints, and its hand with two parallel jaws."""

from __future__ import annotations

import math

from orbit_assets.cache import Model
from orbit_assets.compose import add_frames, edit_joints, simplify_collisions, subtree, without
from orbit_assets.robot_parts import PartKind, RobotPart
from orbit_assets.sources import installed_urdf
from orbit_core.preparation.merge import merge_fixed_links
from orbit_core.scene import Articulation, Frame, Gripper, ImplicitPd, Pose, Workspace

SOURCE = "example-robot-data"
LICENCE = "Apache-2.0"
FILE = "robots/panda_description/urdf/panda.urdf"


def arm() -> Articulation:
    """Read the arm up to the frame ``panda_flange``, which has z out of it and carries a hand 45 degrees about z."""
    source = merge_fixed_links(without(installed_urdf(SOURCE, FILE, "franka_panda"), "panda_hand"))
    # The maker's flange is 0.107 m out of link 7; hands are mounted at -45 degrees.
    flange = Frame("panda_flange", "panda_link7", Pose.from_euler(0.0, 0.0, -math.pi / 4, (0.0, 0.0, 0.107)))
    return simplified(add_frames(source, flange))


def simplified(articulation: Articulation) -> Articulation:
    """Add the motors' inertia to the arm or its hand, and reduce the points of its collision shapes."""
    # The URDF leaves the motors' inertia out. 0.1 is that of a 10 kg mm^2 rotor behind a gear of 100:1; the fingers
    # (15 g) get as many kg, so that the drive and the contact forces act on bodies of like weight.
    note = "armature of 0.1 kg m^2 (arm) and 0.1 kg (fingers) is the catalogue's choice: the URDF has none"
    return simplify_collisions(edit_joints(articulation, (".*",), note, armature=0.1))


PANDA = RobotPart(
    name="franka_panda",
    kind=PartKind.ARM,
    model=Model("franka_panda_arm", arm, (SOURCE,), LICENCE),
    # The open hand points 46 degrees forward from straight down, before the base.
    home={
        "panda_joint1": 0.0,
        "panda_joint2": -0.569,
        "panda_joint3": 0.0,
        "panda_joint4": -2.810,
        "panda_joint5": 0.0,
        "panda_joint6": 3.037,
        "panda_joint7": 0.741,
    },
    drives=(ImplicitPd(joints=("panda_joint[1-7]",), stiffness=400.0, damping=80.0),),
    mount="panda_flange",
    joints=("panda_joint[1-7]",),
    workspace=Workspace(),
    end_effector="panda_hand",
)


def hand() -> Articulation:
    """Read the hand; its frame ``panda_hand_tcp`` is between the finger pads, 0.1034 m out of its root."""
    return simplified(merge_fixed_links(subtree(installed_urdf(SOURCE, FILE), "panda_hand")))


HAND = RobotPart(
    name="panda_hand",
    kind=PartKind.END_EFFECTOR,
    model=Model("panda_hand", hand, (SOURCE,), LICENCE, parts=(simplified,)),
    home={"panda_finger_joint.*": 0.04},
    drives=(ImplicitPd(joints=("panda_finger_joint1",), stiffness=2000.0, damping=100.0),),
    frame="panda_hand_tcp",
    gripper=Gripper(("panda_finger_joint1",), 0.04, 0.0),
)
