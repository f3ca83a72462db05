"""Rethink Robotics: Baxter's left arm of seven joints, and its electric gripper with two parallel jaws."""

from __future__ import annotations

import math

from orbit_assets.cache import Model
from orbit_assets.compose import add_frames, edit_joints, inertia_of_shapes, subtree, without
from orbit_assets.drive_design import DriveDesign, with_armature
from orbit_assets.robot_parts import PartKind, RobotPart
from orbit_assets.sources import installed_urdf
from orbit_core.preparation.merge import merge_fixed_links
from orbit_core.scene import Articulation, Frame, Gripper, ImplicitPd, Pose, Workspace

SOURCE = "example-robot-data"
LICENCE = "BSD"
FILE = "robots/baxter_description/urdf/baxter.urdf"
ARM_JOINTS = ("left_[sew][012]",)


def arm() -> Articulation:
    """Read the arm from its mount on the torso to the frame ``left_flange``, z out of it, x towards the base."""
    source = subtree(installed_urdf(SOURCE, FILE), "left_arm_mount", "baxter_arm")
    arm = merge_fixed_links(without(source, "left_gripper_base_link"))
    return with_armature(
        add_frames(arm, Frame("left_flange", "left_hand_link", Pose.from_euler(0.0, 0.0, math.pi, (0.0, 0.0, 0.025))))
    )


BAXTER_ARM = RobotPart(
    name="baxter_arm",
    kind=PartKind.ARM,
    model=Model("baxter_arm", arm, (SOURCE,), LICENCE, parts=(with_armature,)),
    home={"left_s1": -1.403, "left_e1": 1.765, "left_w1": 1.208},
    designs=(DriveDesign(joints=ARM_JOINTS),),
    mount="left_flange",
    joints=ARM_JOINTS,
    workspace=Workspace((0.45, -0.2, 0.05), (0.65, 0.2, 0.3)),
    end_effector="rethink_gripper",
)


FINGER = "l_gripper_l_finger_joint"


def gripper() -> Articulation:
    """Read the gripper in its wider setting: 16 to 58 mm between the pads, which are boxes in the URDF already.

    The frame ``rethink_tcp`` is in the middle of the pads; the URDF's own, ``left_gripper``, is at their tips.
    """
    source = merge_fixed_links(subtree(installed_urdf(SOURCE, FILE), "left_gripper_base_link", "rethink_gripper"))
    # Inertias of the file are placeholders.
    fingers = inertia_of_shapes(source, ("l_gripper_._finger", "left_gripper_base_link"))
    note = "armature of 0.1 kg on the Rethink gripper's fingers is the catalogue's choice: they weigh 30 g"
    fingers = edit_joints(fingers, (".*",), note, armature=0.1)
    note = "effort limit of 40 N on the Rethink gripper's drive, which moves both fingers: the URDF's 20 N at each pad"
    fingers = edit_joints(fingers, (FINGER,), note, effort_limit=40.0)
    return add_frames(fingers, Frame("rethink_tcp", "left_gripper", Pose((0.0, 0.0, -0.015))))


GRIPPER = RobotPart(
    name="rethink_gripper",
    kind=PartKind.END_EFFECTOR,
    model=Model("rethink_gripper", gripper, (SOURCE,), LICENCE, parts=(inertia_of_shapes,)),
    home={FINGER: 0.0208, "l_gripper_r_finger_joint": -0.0208},
    drives=(ImplicitPd(joints=(FINGER,), stiffness=4000.0, damping=80.0),),
    frame="rethink_tcp",
    gripper=Gripper((FINGER,), 0.0208, 0.0),
)
