"""PAL Robotics: TIAGo's base and arm; TIAGo Pro's base, left arm and gripper."""

from __future__ import annotations

import math
from dataclasses import replace

from orbit_assets.cache import Model
from orbit_assets.compose import (
    add_frames,
    attach,
    branch,
    edit_joints,
    edit_links,
    simplify_collisions,
    subtree,
    without,
)
from orbit_assets.drive_design import DriveDesign, with_armature
from orbit_assets.robot_parts import PartKind, RobotPart
from orbit_assets.sources import installed_urdf
from orbit_core.preparation.merge import merge_fixed_links
from orbit_core.scene import (
    Articulation,
    Box,
    Cylinder,
    DifferentialBase,
    Frame,
    Gripper,
    ImplicitPd,
    Joint,
    JointType,
    Link,
    PlanarBase,
    Pose,
    Shape,
    Sphere,
    Workspace,
)

SOURCE = "example-robot-data"
LICENCE = "Apache-2.0"
TIAGO_FILE = "robots/tiago_description/robots/tiago.urdf"
CASTERS = "TIAGo's casters, fixed in the URDF, swivel and roll; 1 mm less in radius leaves its weight to the wheels"
TREADS = "TIAGo's driven wheels collide 1 cm wide, as crowned treads: as flat ones of 4 cm they would scrub in turns"


def tiago_base() -> Articulation:
    """Base, torso and head; ``mount`` is the arm's seat on the torso."""
    body = without(installed_urdf(SOURCE, TIAGO_FILE, "tiago_base"), "arm_1_link")
    joints = (
        replace(joint, type=JointType.CONTINUOUS) if joint.name.startswith("caster_") else joint
        for joint in body.joints
    )
    body = simplify_collisions(merge_fixed_links(replace(body, joints=tuple(joints))))
    # Spheres and thin cylinders touch the ground at one place: meshes of wheels stick in turns.
    ball = (Shape(Sphere(0.024), name="caster"),)
    tread = (Shape(Cylinder(0.0985, 0.005), name="tread"),)
    body = edit_links(body, ("caster_.*_2_link",), CASTERS, lambda link: replace(link, collisions=ball))
    body = edit_links(body, ("wheel_.*_link",), TREADS, lambda link: replace(link, collisions=tread))
    return with_armature(add_frames(body, Frame("mount", "torso_lift_link", Pose((0.155, 0.014, -0.151)))))


TIAGO_BASE = RobotPart(
    name="tiago_base",
    kind=PartKind.BASE,
    model=Model("tiago_base", tiago_base, (SOURCE,), LICENCE, parts=(with_armature,)),
    home={"torso_lift_joint": 0.15},
    drives=(ImplicitPd(joints=("wheel_.*_joint",), stiffness=0.0, damping=40.0),),
    designs=(DriveDesign(joints=("torso_lift_joint", "head_._joint")),),
    mount="mount",
    wheels=("wheel_left_link", "wheel_right_link"),
    differential_base=DifferentialBase("wheel_left_joint", "wheel_right_joint", radius=0.0985, track=0.404),
    fixed_base=False,
)


TIAGO_ARM_JOINTS = ("arm_[1-7]_joint",)


def tiago_arm() -> Articulation:
    """Read the arm from its seat on the torso to the frame ``arm_flange``, z out of it."""
    # The arm's frame at the torso is turned so that the arm reaches along x, as other arms do.
    sideways = Pose.from_euler(0.0, 0.0, -math.pi / 2)
    source = branch(installed_urdf(SOURCE, TIAGO_FILE), "arm_1_joint", "torso_arm_link", "tiago_arm", sideways)
    limb = merge_fixed_links(without(without(source, "hand_palm_link"), "hand_safety_box"))
    flange = Frame("arm_flange", "arm_7_link", Pose((0.0, 0.0, 0.067)))
    return with_armature(simplify_collisions(add_frames(limb, flange)))


TIAGO_ARM = RobotPart(
    name="tiago_arm",
    kind=PartKind.ARM,
    model=Model("tiago_arm", tiago_arm, (SOURCE,), LICENCE, parts=(with_armature,)),
    home={
        "arm_1_joint": 1.088,
        "arm_2_joint": 0.579,
        "arm_3_joint": -0.81,
        "arm_4_joint": 1.725,
        "arm_5_joint": 0.641,
        "arm_6_joint": -0.858,
        "arm_7_joint": 0.759,
    },
    designs=(DriveDesign(joints=TIAGO_ARM_JOINTS),),
    mount="arm_flange",
    joints=TIAGO_ARM_JOINTS,
    workspace=Workspace((0.45, -0.2, -0.4), (0.65, 0.2, -0.15)),
    end_effector="robotiq_2f85",
    pose=Pose((0.0, 0.0, 0.5)),
)


TIAGO_PRO_FILE = "robots/tiago_pro_description/robots/tiago_pro.urdf"
TIAGO_PRO_ARM_JOINTS = ("arm_left_[1-7]_joint",)


def tiago_pro_arm() -> Articulation:
    """Read the arm from its seat on the torso, joint 1 upright, to the frame ``arm_left_tool_link``, z out of it."""
    source = branch(installed_urdf(SOURCE, TIAGO_PRO_FILE), "arm_left_1_joint", "torso_arm_left_link", "tiago_pro_arm")
    return with_armature(simplify_collisions(merge_fixed_links(without(source, "gripper_left_base_link"))))


TIAGO_PRO_ARM = RobotPart(
    name="tiago_pro_arm",
    kind=PartKind.ARM,
    model=Model("tiago_pro_arm", tiago_pro_arm, (SOURCE,), LICENCE, parts=(with_armature,)),
    home={
        "arm_left_1_joint": 3.104,
        "arm_left_2_joint": 0.485,
        "arm_left_3_joint": -1.81,
        "arm_left_4_joint": -1.887,
        "arm_left_5_joint": -2.661,
        "arm_left_6_joint": 1.4,
        "arm_left_7_joint": -0.395,
    },
    designs=(DriveDesign(joints=TIAGO_PRO_ARM_JOINTS),),
    mount="arm_left_tool_link",
    joints=TIAGO_PRO_ARM_JOINTS,
    workspace=Workspace((0.35, -0.2, 0.1), (0.55, 0.2, 0.35)),
    end_effector="tiago_pro_gripper",
)


FINGER = "gripper_left_finger_joint"


def tiago_pro_gripper() -> Articulation:
    """Read the gripper with two parallel jaws, open by 79 mm; the frame ``gripper_left_tcp`` is between the pads."""
    hand = merge_fixed_links(
        subtree(installed_urdf(SOURCE, TIAGO_PRO_FILE), "gripper_left_base_link", "tiago_pro_gripper")
    )
    hand = add_frames(hand, Frame("gripper_left_tcp", "gripper_left_base_link", Pose((0.0, 0.0, 0.155))))
    note = "TIAGo Pro's finger tips collide as one box each, so that flat pads meet what they hold"
    hand = edit_links(simplify_collisions(hand), ("gripper_left_fingertip_.*_link",), note, _boxed_tip)
    note = "effort limit of 2 N m on TIAGo Pro's gripper, some 20 N at each pad: with the URDF's 0.1 N m it holds 50 g"
    hand = edit_joints(hand, (".*",), note, effort_limit=2.0)
    note = "armature of 0.002 kg m^2 on TIAGo Pro's gripper is the catalogue's choice: its links weigh 30 g"
    return edit_joints(hand, (".*",), note, armature=0.002)


def _boxed_tip(link: Link) -> Link:
    return replace(link, collisions=(Shape(Box((0.005, 0.02, 0.0125)), Pose((-0.0065, 0.027, 0.0)), name="pad"),))


TIAGO_PRO_GRIPPER = RobotPart(
    name="tiago_pro_gripper",
    kind=PartKind.END_EFFECTOR,
    model=Model("tiago_pro_gripper", tiago_pro_gripper, (SOURCE,), LICENCE, parts=(tiago_pro_arm,)),
    drives=(ImplicitPd(joints=(FINGER,), stiffness=20.0, damping=1.0),),
    frame="gripper_left_tcp",
    gripper=Gripper((FINGER,), 0.0, 0.8),
)


# The URDF's wheels: radius, half the distance between the front and rear ones and between left and right ones, limits.
RADIUS, LENGTH, WIDTH, WHEEL_EFFORT, WHEEL_RATE = 0.0762, 0.244, 0.223, 6.0, 13.123
# Wheels turn at (|x'| + |y'| + (LENGTH + WIDTH) |yaw'|) / RADIUS (Taheri, Qiao and Ghaeminezhad, Kinematic Model of a
# Four Mecanum Wheeled Mobile Robot, 2015), and push with all four.
SPEED, FORCE = WHEEL_RATE * RADIUS, 4.0 * WHEEL_EFFORT / RADIUS
# A yaw rate moves each wheel's contact at this lever.
LEVER = LENGTH + WIDTH
WHEELS = tuple(f"wheel_{end}_{side}_link" for end in ("front", "rear") for side in ("left", "right"))


def base_omni() -> Articulation:
    """Read the base on virtual joints ``base_x``, ``base_y`` and ``base_yaw``; an arm's frame is ``mount``."""
    source = installed_urdf(SOURCE, "robots/tiago_pro_description/robots/tiago_pro.urdf")
    body = without(without(source, "torso_base_link"), "torso_fixed_column_link")
    # Its rollers are not in the model: wheels that slid sideways would scrape, so they neither turn nor collide.
    fixed = (replace(joint, type=JointType.FIXED) if joint.child in WHEELS else joint for joint in body.joints)
    links = (replace(link, collisions=()) if link.name in WHEELS else link for link in body.links)
    body = simplify_collisions(merge_fixed_links(replace(body, links=tuple(links), joints=tuple(fixed))))
    body = add_frames(body, Frame("mount", "base_footprint", Pose((0.1, 0.0, 0.307))))
    x, y = (
        Joint(f"base_{name}", JointType.PRISMATIC, parent, f"base_{name}_link", axis=axis,
              effort_limit=FORCE, velocity_limit=SPEED)
        for name, parent, axis in (("x", "base_omni", (1.0, 0.0, 0.0)), ("y", "base_x_link", (0.0, 1.0, 0.0)))
    )  # fmt: skip
    yaw = Joint("base_yaw", JointType.CONTINUOUS, "base_y_link", "base_yaw_link",
                effort_limit=FORCE * LEVER, velocity_limit=SPEED / LEVER)  # fmt: skip
    # Translations before the rotation: the base moves along the world's axes, as commands have it.
    chain = Articulation("base_omni", tuple(map(Link, ("base_omni", *(j.child for j in (x, y, yaw))))), (x, y, yaw))
    note = (
        "the base moves by virtual joints x, y and yaw, limits from those of its wheels, which do not turn or collide"
    )
    return merge_fixed_links(replace(attach(chain, body, "base_yaw_link"), notes=(*body.notes, note)))


BASE_OMNI = RobotPart(
    name="base_omni",
    kind=PartKind.BASE,
    model=Model("base_omni", base_omni, (SOURCE,), LICENCE),
    drives=(
        # Velocities, which 60 kg reach within 20 ms, as far as the wheels push that much.
        ImplicitPd(joints=("base_[xy]",), stiffness=0.0, damping=3000.0),
        ImplicitPd(joints=("base_yaw",), stiffness=0.0, damping=300.0),
    ),
    mount="mount",
    planar_base=PlanarBase("base_x", "base_y", "base_yaw"),
    wheels=WHEELS,
)
