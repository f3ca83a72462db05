"""UFACTORY xArm 7, an arm of seven joints."""

from __future__ import annotations

import math

from orbit_assets.cache import Model
from orbit_assets.compose import add_frames, simplify_collisions, subtree
from orbit_assets.drive_design import DriveDesign, with_armature
from orbit_assets.installed import installed_urdf
from orbit_assets.parts import PartKind, RobotPart
from orbit_core.preparation.merge import merge_fixed_links
from orbit_core.scene import Articulation, Frame, Pose, Workspace

SOURCE = "example-robot-data"


def articulation() -> Articulation:
    """The arm up to the frame ``flange``, which is ``link_eef`` turned: z out of it, y across at home."""
    source = subtree(installed_urdf(SOURCE, "robots/xarm_description/urdf/xarm7.urdf"), "link_base", "xarm7")
    arm = with_armature(simplify_collisions(merge_fixed_links(source)))
    return add_frames(arm, Frame("flange", "link_eef", Pose.from_euler(0.0, 0.0, -math.pi / 2)))


PART = RobotPart(
    name="xarm7",
    kind=PartKind.ARM,
    model=Model("xarm7", articulation, (SOURCE,), "BSD-3-Clause", parts=(with_armature,)),
    home={
        "joint1": -0.183,
        "joint2": -0.269,
        "joint3": 0.162,
        "joint4": 1.01,
        "joint5": 0.045,
        "joint6": 1.276,
        "joint7": 1.531,
    },
    designs=(DriveDesign(joints=("joint[1-7]",)),),
    mount="flange",
    joints=("joint[1-7]",),
    workspace=Workspace((0.35, -0.2, 0.1), (0.55, 0.2, 0.35)),
)
