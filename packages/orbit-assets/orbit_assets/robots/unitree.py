"""Unitree: the quadrupeds A1, Go1 and Go2, the Dex3 hands, and the humanoid G1 with hands of rubber or Dex3."""

from __future__ import annotations

from dataclasses import replace

from orbit_assets.cache import Model
from orbit_assets.compose import add_frames, edit_links, simplify_collisions, subtree
from orbit_assets.drive_design import DriveDesign, with_armature
from orbit_assets.robot_parts import PartKind, RobotPart
from orbit_assets.robots.hands import bracket, grasp, on_bracket, opened
from orbit_assets.sources import installed_urdf
from orbit_core.preparation.merge import merge_fixed_links
from orbit_core.scene import Articulation, EndEffector, Frame, ImplicitPd, Link, Mesh, Pose, Shape, Sphere
from orbit_core.scene.pose import Vector3

# ANYbotics ANYmal B and C, quadrupeds with twelve joints --------------------------------------------------------------

SOURCE = "example-robot-data"
LICENCE = "BSD-3-Clause"


def anymal_b() -> Articulation:
    """Read the robot, and add the frame ``mount`` on its back."""
    source = installed_urdf(SOURCE, "robots/anymal_b_simple_description/robots/anymal.urdf", "anymal_b")
    body = with_armature(merge_fixed_links(source))
    return add_frames(body, Frame("mount", "base", Pose((0.0, 0.0, 0.15))))


ANYMAL_B = RobotPart(
    name="anymal_b",
    kind=PartKind.BASE,
    model=Model("anymal_b", anymal_b, (SOURCE,), LICENCE, parts=(with_armature,)),
    home={".*_HAA": 0.0, ".F_HFE": 0.4, ".H_HFE": -0.4, ".F_KFE": -0.8, ".H_KFE": 0.8},
    # Gains of Rudin et al., Learning to Walk in Minutes (2021); effort and velocity limits are the URDF's.
    drives=(ImplicitPd(joints=(".*_(HAA|HFE|KFE)",), stiffness=80.0, damping=2.0),),
    mount="mount",
    feet=("LF_FOOT", "RF_FOOT", "LH_FOOT", "RH_FOOT"),
    pose=Pose((0.0, 0.0, 0.6)),
    fixed_base=False,
)


def anymal_c() -> Articulation:
    """Read the robot, and add the frame ``mount`` on its back; its feet are frames on the shanks."""
    body = installed_urdf(SOURCE, "robots/anymal_c_simple_description/urdf/anymal.urdf", "anymal_c")
    return add_frames(merge_fixed_links(body), Frame("mount", "base", Pose((0.0, 0.0, 0.15))))


ANYMAL_C = RobotPart(
    name="anymal_c",
    kind=PartKind.BASE,
    model=Model("anymal_c", anymal_c, (SOURCE,), LICENCE),
    home={".*_HAA": 0.0, ".F_HFE": 0.4, ".H_HFE": -0.4, ".F_KFE": -0.8, ".H_KFE": 0.8},
    # Gains of Rudin et al., Learning to Walk in Minutes (2021); effort and velocity limits are the URDF's, and there is
    # no armature, as in the policies that are kept for it.
    drives=(ImplicitPd(joints=(".*_(HAA|HFE|KFE)",), stiffness=80.0, damping=2.0),),
    mount="mount",
    feet=("LF_FOOT", "RF_FOOT", "LH_FOOT", "RH_FOOT"),
    pose=Pose((0.0, 0.0, 0.6)),  # the feet start slightly above the ground
    fixed_base=False,
)


QUADRUPED_LICENCE = "MPL-2.0"
QUADRUPED_HOME = {".*_hip_joint": 0.0, ".*_thigh_joint": 0.8, ".*_calf_joint": -1.5}
# Twice the gains of legged_gym's A1 (20 and 0.5, Rudin et al. 2021), so that the knees give by some 5 degrees under the
# robot's own weight and not by 10; effort and velocity limits are the URDF's.
QUADRUPED_LEGS = ImplicitPd(joints=(".*_(hip|thigh|calf)_joint",), stiffness=40.0, damping=1.0)


_FOOT = Sphere(radius=0.022)
# Unitree's description puts the sphere 2 mm behind the calf's end.
_FOOT_POSE = Pose((-0.002, 0.0, 0.0))


def _round_feet(articulation: Articulation) -> Articulation:
    """Return the robot with meshes of feet replaced by the spheres that Unitree's own description of the Go2 has there.

    The hull of 33 vertices is such a sphere within 3 mm. On terrain nine in ten of the pieces of ground that an engine
    holds a shape of the robot against are under a foot, and a sphere meets them without an iteration for its depth.
    """

    def edit(link: Link) -> Link:
        shapes = [
            replace(shape, geometry=_FOOT, pose=_FOOT_POSE) if isinstance(shape.geometry, Mesh) else shape
            for shape in link.collisions
        ]
        return replace(link, collisions=tuple(shapes))

    meshes = any(isinstance(shape.geometry, Mesh) for link in articulation.links for shape in link.collisions)
    note = "feet collide as spheres of 22 mm, as in Unitree's own description: the hulls here are those within 3 mm"
    return edit_links(articulation, (".*_foot",), note, edit) if meshes else articulation


def _quadruped(name: str, folder: str, height: float, back: float) -> RobotPart:
    def articulation() -> Articulation:
        source = installed_urdf(SOURCE, f"robots/{folder}_description/urdf/{folder}.urdf", name)
        body = with_armature(simplify_collisions(merge_fixed_links(_round_feet(source))))
        return add_frames(body, Frame("mount", "base", Pose((0.0, 0.0, back))))

    return RobotPart(
        name=name,
        kind=PartKind.BASE,
        model=Model(name, articulation, (SOURCE,), QUADRUPED_LICENCE, parts=(with_armature,)),
        home=QUADRUPED_HOME,
        drives=(QUADRUPED_LEGS,),
        mount="mount",
        feet=("FL_foot", "FR_foot", "RL_foot", "RR_foot"),
        pose=Pose((0.0, 0.0, height)),
        fixed_base=False,
    )


# Heights at which the feet touch the ground at home, with the frame on the back.
A1 = _quadruped("unitree_a1", "a1", 0.315, 0.057)
GO1 = _quadruped("unitree_go1", "go1", 0.335, 0.057)
GO2 = _quadruped("unitree_go2", "go2", 0.338, 0.057)
"""Their ``mount`` is on the back, above the middle of the trunk."""


# Of the left hand. The tips are 0.08 m apart where it is open. Closed on what is 0.04 m wide, the fingers press with
# 8.5 N each against 17 N of the thumb.
GRASP = {
    "thumb_0": (0.0, 0.0), "thumb_1": (-0.308, 0.192), "thumb_2": (0.842, 1.166),
    "middle_0": (-0.615, -0.982), "middle_1": (-0.847, -1.014),
    "index_0": (-0.615, -0.982), "index_1": (-0.847, -1.014),
}  # fmt: skip
# The right hand is the mirror image of the left.
_SIGNS = {"left": 1.0, "right": -1.0}
_TIPS = {"thumb": "thumb_2", "middle": "middle_1", "index": "index_1"}


def _dex3(side: str) -> RobotPart:
    sign = _SIGNS[side]
    name, prefix = f"dex3_{side}", f"{side}_hand_"

    def articulation() -> Articulation:
        robot = installed_urdf(SOURCE, "robots/g1_description/urdf/g1_29dof_with_hand_rev_1_0.urdf")
        hand = with_hand_frames(subtree(robot, f"{prefix}palm_link"), side)
        return with_armature(simplify_collisions(on_bracket(hand, name, *_seat(sign))))

    positions = {f"{prefix}{joint}_joint": (sign * a, sign * b) for joint, (a, b) in GRASP.items()}
    return RobotPart(
        name=name,
        kind=PartKind.END_EFFECTOR,
        model=Model(name, articulation, (SOURCE,), LICENCE, parts=(on_bracket, with_armature)),
        home=opened(positions),
        designs=(DriveDesign(joints=(f"{prefix}.*",), natural_frequency=12.0),),
        frame=f"{name}_tcp",
        gripper=grasp(positions),
        finger_tips=tuple(f"{prefix}{tip}_tip" for tip in _TIPS),
        pose=Pose((0.0, 0.0, 0.5)),
    )


def with_hand_frames(robot: Articulation, side: str) -> Articulation:
    """Return the robot with frames on its hand of that side, as the hand's part names them: between the tips, and at
    each.
    """
    sign, prefix = _SIGNS[side], f"{side}_hand_"
    tips = (
        Frame(f"{prefix}{tip}_tip", f"{prefix}{link}_link", Pose(_tip_of(tip, sign))) for tip, link in _TIPS.items()
    )
    tcp = Frame(f"dex3_{side}_tcp", f"{prefix}palm_link", bracket(*_seat(sign)) @ Pose((0.0, -0.006, 0.1087)))
    return add_frames(robot, tcp, *tips)


def _seat(sign: float) -> tuple[Vector3, Vector3, Vector3, float]:
    return (0.0435, 0.0214 * sign, 0.0), (1.0, 0.0, 0.0), (0.0, -sign, 0.0), 70.0


def _tip_of(finger: str, sign: float) -> tuple[float, float, float]:
    """Return the middle of the last link's rounded end, in that link."""
    return (0.0, -0.042 * sign, 0.0) if finger == "thumb" else (0.042, 0.0, 0.0)


DEX3_LEFT, DEX3_RIGHT = _dex3("left"), _dex3("right")


G1_HOME = {".*_hip_pitch_joint": -0.1, ".*_knee_joint": 0.3, ".*_ankle_pitch_joint": -0.2, ".*_elbow_joint": 0.9}
# Unitree's reinforcement learning code has 100 to 150 N m/rad at hips and knees and 40 at the ankles (unitree_rl_gym),
# and needs a policy to stand. A standing body of mass m, h above its ankles, falls where these have less than
# m g h = 34 kg * 9.81 m/s^2 * 0.65 m = 217 N m/rad together; what is under and above them gives too: with 600 it falls.
G1_LEGS = ImplicitPd(joints=(".*_(hip|knee|ankle)_.*joint", "waist_.*_joint"), stiffness=1000.0, damping=25.0)
# For a policy: legs as in Unitree's code, waist and arms as in Isaac Lab's G1 (arms 40), and twice the damping of the
# former at the ankles, whose armature is small. They do not stand by themselves.
G1_WALKING = (
    ImplicitPd(joints=(".*_hip_.*joint", "waist_.*_joint"), stiffness=100.0, damping=3.0),
    ImplicitPd(joints=(".*_knee_joint",), stiffness=150.0, damping=4.0),
    ImplicitPd(joints=(".*_ankle_.*joint",), stiffness=40.0, damping=2.0),
    ImplicitPd(joints=(".*_(shoulder|elbow)_.*joint",), stiffness=40.0, damping=2.0),
    ImplicitPd(joints=(".*_wrist_.*joint",), stiffness=10.0, damping=0.5),
)
G1_ARMS = DriveDesign(joints=(".*_(shoulder|elbow|wrist)_.*joint",))
# The humanoid with hands takes their joints' home and drives from the hands as parts.
HANDS = (DEX3_LEFT, DEX3_RIGHT)
SIDES = ("left", "right")
FOOT_RADIUS = 0.04
"""Metres, of the spheres that a foot stands on."""


def g1() -> Articulation:
    """Read the robot with hands of rubber, which have frames ``left_rubber_hand`` and ``right_rubber_hand``."""
    return _read("unitree_g1", "g1_29dof_rev_1_0")


def g1_with_hands() -> Articulation:
    """Read the robot with Dex3 hands, which have the frames that they have by themselves."""
    body = _read("unitree_g1_dex3", "g1_29dof_with_hand_rev_1_0")
    return with_hand_frames(with_hand_frames(body, "left"), "right")


def _read(name: str, file: str) -> Articulation:
    source = installed_urdf(SOURCE, f"robots/g1_description/urdf/{file}.urdf", name)
    return with_armature(simplify_collisions(merge_fixed_links(_with_larger_spheres(source))))


def _with_larger_spheres(articulation: Articulation) -> Articulation:
    """Return the robot with the spheres at the corners of its soles larger, as low as they were.

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
    model=Model("unitree_g1", g1, (SOURCE,), LICENCE, parts=(with_armature,)),
    home=G1_HOME,
    drives=(G1_LEGS,),
    designs=(G1_ARMS,),
    feet=("left_ankle_roll_link", "right_ankle_roll_link"),
    walking_drives=G1_WALKING,
    end_effectors=tuple(EndEffector(f"{side}_rubber_hand", _arm(side)) for side in SIDES),
    pose=Pose((0.0, 0.0, 0.79)),
    fixed_base=False,
)
G1_DEX3 = RobotPart(
    name="unitree_g1_dex3",
    kind=PartKind.BASE,
    model=Model("unitree_g1_dex3", g1_with_hands, (SOURCE,), LICENCE, parts=(with_armature, with_hand_frames)),
    home={**G1_HOME, **HANDS[0].home, **HANDS[1].home},
    drives=(G1_LEGS,),
    designs=(G1_ARMS, *HANDS[0].designs, *HANDS[1].designs),
    feet=G1.feet,
    walking_drives=G1_WALKING,
    end_effectors=tuple(
        EndEffector(hand.frame, _arm(side), hand.gripper, hand.finger_tips)
        for side, hand in zip(SIDES, HANDS, strict=True)
    ),
    pose=G1.pose,
    fixed_base=False,
)
