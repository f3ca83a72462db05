"""The left arm of PAL Robotics' TIAGo Pro, with seven joints."""

from __future__ import annotations

from orbit_assets.cache import Model
from orbit_assets.compose import branch, simplify_collisions, without
from orbit_assets.drive_design import DriveDesign, with_armature
from orbit_assets.installed import installed_urdf
from orbit_assets.parts import PartKind, RobotPart
from orbit_core.preparation.merge import merge_fixed_links
from orbit_core.scene import Articulation, Workspace

SOURCE = "example-robot-data"
LICENCE = "Apache-2.0"
FILE = "robots/tiago_pro_description/robots/tiago_pro.urdf"
ARM_JOINTS = ("arm_left_[1-7]_joint",)


def arm() -> Articulation:
    """The arm from its seat on the torso, joint 1 upright, to the frame ``arm_left_tool_link``, z out of it."""
    source = branch(installed_urdf(SOURCE, FILE), "arm_left_1_joint", "torso_arm_left_link", "tiago_pro_arm")
    return with_armature(simplify_collisions(merge_fixed_links(without(source, "gripper_left_base_link"))))


PART = RobotPart(
    name="tiago_pro_arm",
    kind=PartKind.ARM,
    model=Model("tiago_pro_arm", arm, (SOURCE,), LICENCE, parts=(with_armature,)),
    home={
        "arm_left_1_joint": 3.104,
        "arm_left_2_joint": 0.485,
        "arm_left_3_joint": -1.81,
        "arm_left_4_joint": -1.887,
        "arm_left_5_joint": -2.661,
        "arm_left_6_joint": 1.4,
        "arm_left_7_joint": -0.395,
    },
    designs=(DriveDesign(joints=ARM_JOINTS),),
    mount="arm_left_tool_link",
    joints=ARM_JOINTS,
    workspace=Workspace((0.35, -0.2, 0.1), (0.55, 0.2, 0.35)),
    end_effector="tiago_pro_gripper",
)
