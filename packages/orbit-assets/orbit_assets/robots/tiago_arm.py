"""The arm of PAL Robotics' TIAGo, with seven joints."""

from __future__ import annotations

import math

from orbit_assets.cache import Model
from orbit_assets.compose import add_frames, branch, simplify_collisions, without
from orbit_assets.drive_design import DriveDesign, with_armature
from orbit_assets.installed import installed_urdf
from orbit_assets.parts import PartKind, RobotPart
from orbit_assets.robots.tiago import FILE, LICENCE, SOURCE
from orbit_core.preparation.merge import merge_fixed_links
from orbit_core.scene import Articulation, Frame, Pose, Workspace

ARM_JOINTS = ("arm_[1-7]_joint",)


def arm() -> Articulation:
    """The arm from its seat on the torso to the frame ``arm_flange``, z out of it."""
    sideways = Pose.from_euler(0.0, 0.0, -math.pi / 2)
    source = branch(installed_urdf(SOURCE, FILE), "arm_1_joint", "torso_arm_link", "tiago_arm", sideways)
    limb = merge_fixed_links(without(without(source, "hand_palm_link"), "hand_safety_box"))
    flange = Frame("arm_flange", "arm_7_link", Pose((0.0, 0.0, 0.067)))
    return with_armature(simplify_collisions(add_frames(limb, flange)))


PART = RobotPart(
    name="tiago_arm",
    kind=PartKind.ARM,
    model=Model("tiago_arm", arm, (SOURCE,), LICENCE, parts=(with_armature,)),
    home={
        "arm_1_joint": 1.088,
        "arm_2_joint": 0.579,
        "arm_3_joint": -0.81,
        "arm_4_joint": 1.725,
        "arm_5_joint": 0.641,
        "arm_6_joint": -0.858,
        "arm_7_joint": 0.759,
    },
    designs=(DriveDesign(joints=ARM_JOINTS),),
    mount="arm_flange",
    joints=ARM_JOINTS,
    workspace=Workspace((0.45, -0.2, -0.4), (0.65, 0.2, -0.15)),
    end_effector="robotiq_2f85",
    pose=Pose((0.0, 0.0, 0.5)),
)
