"""Unitree G1, a humanoid with 29 joints, and the same with Dex3 hands."""

from __future__ import annotations

from dataclasses import replace

from orbit_assets.cache import Model
from orbit_assets.compose import edit_links, simplify_collisions
from orbit_assets.drive_design import DriveDesign, with_armature
from orbit_assets.installed import installed_urdf
from orbit_assets.parts import PartKind, RobotPart
from orbit_assets.robots import dex3_hand
from orbit_core.preparation.merge import merge_fixed_links
from orbit_core.scene import Articulation, EndEffector, ImplicitPd, Link, Pose, Shape, Sphere

SOURCE = "example-robot-data"
LICENCE = "BSD-3-Clause"
HOME = {".*_hip_pitch_joint": -0.1, ".*_knee_joint": 0.3, ".*_ankle_pitch_joint": -0.2, ".*_elbow_joint": 0.9}
# Unitree's reinforcement learning code has 100 to 150 N m/rad at hips and knees and 40 at the ankles (unitree_rl_gym),
# and needs a policy to stand. A standing body of mass m, h above its ankles, falls where these have less than
# m g h = 34 kg * 9.81 m/s^2 * 0.65 m = 217 N m/rad together; what is under and above them gives too: with 600 it falls.
LEGS = ImplicitPd(joints=(".*_(hip|knee|ankle)_.*joint", "waist_.*_joint"), stiffness=1000.0, damping=25.0)
# For a policy: legs as in Unitree's code, waist and arms as in Isaac Lab's G1 (arms 40), and twice the damping of the
# former at the ankles, whose armature is small. They do not stand by themselves.
WALKING = (
    ImplicitPd(joints=(".*_hip_.*joint", "waist_.*_joint"), stiffness=100.0, damping=3.0),
    ImplicitPd(joints=(".*_knee_joint",), stiffness=150.0, damping=4.0),
    ImplicitPd(joints=(".*_ankle_.*joint",), stiffness=40.0, damping=2.0),
    ImplicitPd(joints=(".*_(shoulder|elbow)_.*joint",), stiffness=40.0, damping=2.0),
    ImplicitPd(joints=(".*_wrist_.*joint",), stiffness=10.0, damping=0.5),
)
ARMS = DriveDesign(joints=(".*_(shoulder|elbow|wrist)_.*joint",))
HANDS = (dex3_hand.LEFT, dex3_hand.RIGHT)
SIDES = ("left", "right")
FOOT_RADIUS = 0.04
"""Metres, of the spheres that a foot stands on."""


def articulation() -> Articulation:
    """The robot with hands of rubber, which have frames ``left_rubber_hand`` and ``right_rubber_hand``."""
    return _read("unitree_g1", "g1_29dof_rev_1_0")


def with_hands() -> Articulation:
    """The robot with Dex3 hands, which have the frames that they have by themselves."""
    body = _read("unitree_g1_dex3", "g1_29dof_with_hand_rev_1_0")
    return dex3_hand.with_frames(dex3_hand.with_frames(body, "left"), "right")


def _read(name: str, file: str) -> Articulation:
    source = installed_urdf(SOURCE, f"robots/g1_description/urdf/{file}.urdf", name)
    return with_armature(simplify_collisions(merge_fixed_links(_with_larger_spheres(source))))


def _with_larger_spheres(articulation: Articulation) -> Articulation:
    """The robot with the spheres at the corners of its soles larger, as low as they were.

    Contacts give way by some millimetres where it stamps. A plane pushes a sphere out whose middle it has swallowed,
    but a height field is prisms side by side, and the nearest face, which leads out, may be one between two of them.
    """

    def edit(link: Link) -> Link:
        return replace(link, collisions=tuple(map(_larger, link.collisions)))

    size = f"{1000 * FOOT_RADIUS:.0f} mm"
    note = f"feet stand on spheres of {size}, as low as the URDF's of 5 mm, which sink into terrain"
    return edit_links(articulation, (".*_ankle_roll_link",), note, edit)


def _larger(shape: Shape) -> Shape:
    if not isinstance(shape.geometry, Sphere):
        return shape
    x, y, z = shape.pose.position
    raised = replace(shape.pose, position=(x, y, z + FOOT_RADIUS - shape.geometry.radius))
    return replace(shape, geometry=Sphere(radius=FOOT_RADIUS), pose=raised)


def _arm(side: str) -> tuple[str, ...]:
    return (f"{side}_(shoulder|elbow|wrist)_.*joint",)


G1 = RobotPart(
    name="unitree_g1",
    kind=PartKind.BASE,
    model=Model("unitree_g1", articulation, (SOURCE,), LICENCE, parts=(with_armature,)),
    home=HOME,
    drives=(LEGS,),
    designs=(ARMS,),
    feet=("left_ankle_roll_link", "right_ankle_roll_link"),
    walking_drives=WALKING,
    end_effectors=tuple(EndEffector(f"{side}_rubber_hand", _arm(side)) for side in SIDES),
    pose=Pose((0.0, 0.0, 0.79)),
    fixed_base=False,
)
G1_DEX3 = RobotPart(
    name="unitree_g1_dex3",
    kind=PartKind.BASE,
    model=Model("unitree_g1_dex3", with_hands, (SOURCE,), LICENCE, parts=(with_armature, dex3_hand.with_frames)),
    home={**HOME, **HANDS[0].home, **HANDS[1].home},
    drives=(LEGS,),
    designs=(ARMS, *HANDS[0].designs, *HANDS[1].designs),
    feet=G1.feet,
    walking_drives=WALKING,
    end_effectors=tuple(
        EndEffector(hand.frame, _arm(side), hand.gripper, hand.finger_tips)
        for side, hand in zip(SIDES, HANDS, strict=True)
    ),
    pose=G1.pose,
    fixed_base=False,
)
