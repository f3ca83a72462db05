"""Kinova's hand KG-2 with two fingers, which the Jaco 2 carries."""

from __future__ import annotations

from dataclasses import replace

from orbit_assets.cache import Model
from orbit_assets.compose import add_frames, edit_joints, simplify_collisions
from orbit_assets.installed import installed_urdf
from orbit_assets.parts import PartKind, RobotPart
from orbit_assets.robots.jaco2 import FILE, LICENCE, PALM, SOURCE, arm
from orbit_core.preparation.merge import merge_fixed_links
from orbit_core.scene import Articulation, Frame, Gripper, ImplicitPd, JointType, Link, Mimic, Pose

FINGERS = tuple(f"j2s6s200_joint_finger_{side}" for side in (1, 2))


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
    note = (
        "the URDF fixes the KG-2's fingers: here they turn from 0 to 1.51 rad as in Kinova's own models, whose 2 N m "
        "at each of two motors are 4 N m of the one drive"
    )
    return simplify_collisions(edit_joints(fingers, FINGERS, note, armature=0.002))


def _moving(name: str) -> dict[str, object]:
    limits = {"lower_limit": 0.0, "upper_limit": 1.51, "effort_limit": 4.0, "velocity_limit": 1.0}
    mimic = None if name == FINGERS[0] else Mimic(FINGERS[0])
    return {"type": JointType.REVOLUTE, "axis": (0.0, 0.0, 1.0), "mimic": mimic, **limits}


PART = RobotPart(
    name="kinova_kg2",
    kind=PartKind.END_EFFECTOR,
    model=Model("kinova_kg2", hand, (SOURCE,), LICENCE, parts=(arm,)),
    home={FINGERS[0]: 0.2, FINGERS[1]: 0.2},
    drives=(ImplicitPd(joints=FINGERS[:1], stiffness=20.0, damping=1.0),),
    frame="kg2_tcp",
    gripper=Gripper(FINGERS[:1], 0.2, 1.4),
)
