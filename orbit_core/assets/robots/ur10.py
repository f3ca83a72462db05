"""Universal Robots UR10, an arm of six joints."""

from __future__ import annotations

from orbit_core.assets.cache import Model
from orbit_core.assets.compose import simplify_collisions, subtree
from orbit_core.assets.installed import installed_urdf
from orbit_core.assets.merge import merge_fixed_links
from orbit_core.assets.parts import PartKind, RobotPart
from orbit_core.dynamics.drive_design import DriveDesign, with_armature
from orbit_core.scene import Articulation

SOURCE = "example-robot-data"


def articulation() -> Articulation:
    """The arm up to its flange ``tool0``, which has z out of it."""
    source = installed_urdf(SOURCE, "robots/ur_description/urdf/ur10_robot.urdf", "ur10")
    return with_armature(simplify_collisions(merge_fixed_links(subtree(source, "base_link", "ur10"))))


PART = RobotPart(
    name="ur10",
    kind=PartKind.ARM,
    model=Model("ur10", articulation, (SOURCE,), "BSD", parts=(with_armature,)),
    home={
        "shoulder_pan_joint": -0.277,
        "shoulder_lift_joint": -1.739,
        "elbow_joint": 1.91,
        "wrist_1_joint": -1.742,
        "wrist_2_joint": -1.571,
        "wrist_3_joint": -0.277,
    },
    designs=(DriveDesign(joints=("shoulder_.*_joint", "elbow_joint", "wrist_[123]_joint")),),
    mount="tool0",
    joints=("shoulder_.*_joint", "elbow_joint", "wrist_[123]_joint"),
)
