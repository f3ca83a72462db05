"""Kinova Jaco 2 (j2s6s200), an arm of six joints."""

from __future__ import annotations

import math

from orbit_assets.cache import Model
from orbit_assets.compose import add_frames, simplify_collisions, without
from orbit_assets.drive_design import DriveDesign, with_armature
from orbit_assets.installed import installed_urdf
from orbit_assets.parts import PartKind, RobotPart
from orbit_core.preparation.merge import merge_fixed_links
from orbit_core.scene import Articulation, Frame, Pose, Workspace

SOURCE = "example-robot-data"
LICENCE = "BSD"
FILE = "robots/kinova_description/robots/kinova.urdf"
PALM = Frame("j2s6s200_palm", "j2s6s200_link_6", Pose.from_euler(0.0, math.pi, 0.0, (0.0, 0.0, -0.12)))


def arm() -> Articulation:
    """The arm with the palm that is one with its last link, up to the frame ``j2s6s200_palm``, z out of it."""
    source = installed_urdf(SOURCE, FILE, "jaco2")
    for side in (1, 2):
        source = without(source, f"j2s6s200_link_finger_{side}")
    return with_armature(add_frames(simplify_collisions(merge_fixed_links(source)), PALM))


PART = RobotPart(
    name="jaco2",
    kind=PartKind.ARM,
    model=Model("jaco2", arm, (SOURCE,), LICENCE, parts=(with_armature,)),
    home={
        "j2s6s200_joint_1": -1.551,
        "j2s6s200_joint_2": 3.664,
        "j2s6s200_joint_3": 1.775,
        "j2s6s200_joint_4": -3.142,
        "j2s6s200_joint_5": 1.888,
        "j2s6s200_joint_6": -3.122,
    },
    designs=(DriveDesign(joints=("j2s6s200_joint_[1-6]",)),),
    mount="j2s6s200_palm",
    joints=("j2s6s200_joint_[1-6]",),
    workspace=Workspace((0.35, -0.2, 0.1), (0.55, 0.2, 0.35)),
    end_effector="kinova_kg2",
)
