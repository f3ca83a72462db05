"""The left arm of Rethink Robotics' Baxter, with seven joints."""

from __future__ import annotations

import math

from orbit_assets.cache import Model
from orbit_assets.compose import add_frames, subtree, without
from orbit_assets.drive_design import DriveDesign, with_armature
from orbit_assets.installed import installed_urdf
from orbit_assets.parts import PartKind, RobotPart
from orbit_core.preparation.merge import merge_fixed_links
from orbit_core.scene import Articulation, Frame, Pose, Workspace

SOURCE = "example-robot-data"
LICENCE = "BSD"
FILE = "robots/baxter_description/urdf/baxter.urdf"
ARM_JOINTS = ("left_[sew][012]",)


def arm() -> Articulation:
    """The arm from its mount on the torso to the frame ``left_flange``, z out of it, x towards the base at home."""
    source = subtree(installed_urdf(SOURCE, FILE), "left_arm_mount", "baxter_arm")
    arm = merge_fixed_links(without(source, "left_gripper_base_link"))
    return with_armature(
        add_frames(arm, Frame("left_flange", "left_hand_link", Pose.from_euler(0.0, 0.0, math.pi, (0.0, 0.0, 0.025))))
    )


PART = RobotPart(
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
