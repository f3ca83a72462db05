"""PAL Robotics' TIAGo: a base on two driven wheels with torso and head."""

from __future__ import annotations

from dataclasses import replace

from orbit_assets.cache import Model
from orbit_assets.compose import add_frames, edit_links, simplify_collisions, without
from orbit_assets.drive_design import DriveDesign, with_armature
from orbit_assets.installed import installed_urdf
from orbit_assets.parts import PartKind, RobotPart
from orbit_core.preparation.merge import merge_fixed_links
from orbit_core.scene import (
    Articulation,
    Cylinder,
    DifferentialBase,
    Frame,
    ImplicitPd,
    JointType,
    Pose,
    Shape,
    Sphere,
)

SOURCE = "example-robot-data"
LICENCE = "Apache-2.0"
FILE = "robots/tiago_description/robots/tiago.urdf"
CASTERS = "TIAGo's casters, fixed in the URDF, swivel and roll; 1 mm less in radius leaves its weight to the wheels"
WHEELS = "TIAGo's driven wheels collide 1 cm wide, as crowned treads: as flat ones of 4 cm they would scrub in turns"


def base() -> Articulation:
    """Base, torso and head; ``mount`` is the arm's seat on the torso."""
    body = without(installed_urdf(SOURCE, FILE, "tiago_base"), "arm_1_link")
    joints = (
        replace(joint, type=JointType.CONTINUOUS) if joint.name.startswith("caster_") else joint
        for joint in body.joints
    )
    body = simplify_collisions(merge_fixed_links(replace(body, joints=tuple(joints))))
    ball = (Shape(Sphere(0.024), name="caster"),)
    tread = (Shape(Cylinder(0.0985, 0.005), name="tread"),)
    body = edit_links(body, ("caster_.*_2_link",), CASTERS, lambda link: replace(link, collisions=ball))
    body = edit_links(body, ("wheel_.*_link",), WHEELS, lambda link: replace(link, collisions=tread))
    return with_armature(add_frames(body, Frame("mount", "torso_lift_link", Pose((0.155, 0.014, -0.151)))))


PART = RobotPart(
    name="tiago_base",
    kind=PartKind.BASE,
    model=Model("tiago_base", base, (SOURCE,), LICENCE, parts=(with_armature,)),
    home={"torso_lift_joint": 0.15},
    drives=(ImplicitPd(joints=("wheel_.*_joint",), stiffness=0.0, damping=40.0),),
    designs=(DriveDesign(joints=("torso_lift_joint", "head_._joint")),),
    mount="mount",
    wheels=("wheel_left_link", "wheel_right_link"),
    differential_base=DifferentialBase("wheel_left_joint", "wheel_right_joint", radius=0.0985, track=0.404),
    fixed_base=False,
)
