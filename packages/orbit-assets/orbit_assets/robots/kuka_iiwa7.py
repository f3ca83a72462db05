"""KUKA LBR iiwa 7, an arm of seven joints."""

from __future__ import annotations

import math

from orbit_assets.cache import Model
from orbit_assets.compose import add_frames, edit_joints, simplify_collisions
from orbit_assets.drive_design import DriveDesign, with_armature
from orbit_assets.installed import installed_urdf
from orbit_assets.parts import PartKind, RobotPart
from orbit_core.preparation.merge import merge_fixed_links
from orbit_core.scene import Articulation, Frame, Pose, Workspace

SOURCE = "pybullet"


FLANGE = Frame("flange", "lbr_iiwa_link_7", Pose.from_euler(0.0, 0.0, -math.pi / 2, (0.0, 0.0, 0.045)))


def articulation() -> Articulation:
    """The arm up to the frame ``flange`` on its last link, 45 mm out, with z out of it."""
    source = installed_urdf(SOURCE, "pybullet_data/kuka_iiwa/model.urdf", "kuka_iiwa7")
    arm = simplify_collisions(merge_fixed_links(source))
    note = "velocity limit of 1.71 rad/s, the maker's for its slowest axes: the URDF has 10 rad/s on all"
    arm = edit_joints(arm, (".*",), note, velocity_limit=1.71)
    return with_armature(add_frames(arm, FLANGE))


PART = RobotPart(
    name="kuka_iiwa7",
    kind=PartKind.ARM,
    model=Model("kuka_iiwa7", articulation, (SOURCE,), "zlib", parts=(with_armature,)),
    home={
        "lbr_iiwa_joint_1": -0.162,
        "lbr_iiwa_joint_2": 0.275,
        "lbr_iiwa_joint_3": 0.203,
        "lbr_iiwa_joint_4": -1.547,
        "lbr_iiwa_joint_5": -0.057,
        "lbr_iiwa_joint_6": 1.325,
        "lbr_iiwa_joint_7": -1.523,
    },
    designs=(DriveDesign(joints=("lbr_iiwa_joint_[1-7]",)),),
    mount="flange",
    workspace=Workspace(),
    joints=("lbr_iiwa_joint_[1-7]",),
)
