"""Kinova Jaco 2 (j2s6s200), an arm of six joints, and its hand KG-2 with two fingers."""

from __future__ import annotations

import math
from dataclasses import replace

from orbit_core.assets.cache import Model
from orbit_core.assets.compose import add_frames, edit_joints, simplify_collisions, without
from orbit_core.assets.installed import installed_urdf
from orbit_core.assets.merge import merge_fixed_links
from orbit_core.assets.parts import PartKind, RobotPart
from orbit_core.dynamics.drive_design import DriveDesign, with_armature
from orbit_core.scene import Articulation, Frame, Gripper, ImplicitPd, JointType, Link, Mimic, Pose, Workspace

SOURCE = "example-robot-data"
LICENCE = "BSD"
FILE = "robots/kinova_description/robots/kinova.urdf"
FINGERS = tuple(f"j2s6s200_joint_finger_{side}" for side in (1, 2))
PALM = Frame("j2s6s200_palm", "j2s6s200_link_6", Pose.from_euler(0.0, math.pi, 0.0, (0.0, 0.0, -0.12)))


def arm() -> Articulation:
    """The arm with the palm that is one with its last link, up to the frame ``j2s6s200_palm``, z out of it."""
    source = installed_urdf(SOURCE, FILE, "jaco2")
    for side in (1, 2):
        source = without(source, f"j2s6s200_link_finger_{side}")
    return with_armature(add_frames(simplify_collisions(merge_fixed_links(source)), PALM))


def hand() -> Articulation:
    """The two fingers, each one rigid body; the frame ``kg2_tcp`` lies between their tips."""
    source = installed_urdf(SOURCE, FILE, "kinova_kg2")
    palm, seat = "kg2_palm", PALM.pose.inverse()
    links = tuple(link for link in source.links if "finger" in link.name)
    joints = tuple(
        replace(joint, parent=palm, parent_pose=seat @ joint.parent_pose, **_moving(joint.name))
        if joint.name in FINGERS
        else joint
        for joint in source.joints
        if "finger" in joint.name
    )
    fingers = merge_fixed_links(replace(source, links=(Link(palm), *links), joints=joints, frames=()))
    fingers = add_frames(fingers, Frame("kg2_tcp", palm, Pose((0.0, 0.0, 0.06))))
    note = "the URDF fixes the KG-2's fingers: here they turn from 0 to 1.51 rad, 2 N m, as in Kinova's own models"
    return simplify_collisions(edit_joints(fingers, FINGERS, note, armature=0.002))


def _moving(name: str) -> dict[str, object]:
    limits = {"lower_limit": 0.0, "upper_limit": 1.51, "effort_limit": 2.0, "velocity_limit": 1.0}
    mimic = None if name == FINGERS[0] else Mimic(FINGERS[0])
    return {"type": JointType.REVOLUTE, "axis": (0.0, 0.0, 1.0), "mimic": mimic, **limits}


ARM = RobotPart(
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
HAND = RobotPart(
    name="kinova_kg2",
    kind=PartKind.END_EFFECTOR,
    model=Model("kinova_kg2", hand, (SOURCE,), LICENCE),
    home={FINGERS[0]: 0.2, FINGERS[1]: 0.2},
    drives=(ImplicitPd(joints=FINGERS[:1], stiffness=20.0, damping=1.0),),
    frame="kg2_tcp",
    gripper=Gripper(FINGERS[:1], 0.2, 1.4),
)
