"""Unitree's Dex3 hands, left and right: two fingers of two joints and a thumb of three."""

from __future__ import annotations

from orbit_assets.cache import Model
from orbit_assets.compose import add_frames, simplify_collisions, subtree
from orbit_assets.drive_design import DriveDesign, with_armature
from orbit_assets.installed import installed_urdf
from orbit_assets.parts import PartKind, RobotPart
from orbit_assets.robots.hands import bracket, grasp, on_bracket, opened
from orbit_core.scene import Articulation, Frame, Pose
from orbit_core.scene.pose import Vector3

SOURCE = "example-robot-data"
LICENCE = "BSD-3-Clause"
# Of the left hand. The tips are 0.08 m apart where it is open. Closed on what is 0.04 m wide, the fingers press with
# 8.5 N each against 17 N of the thumb.
GRASP = {
    "thumb_0": (0.0, 0.0), "thumb_1": (-0.308, 0.192), "thumb_2": (0.842, 1.166),
    "middle_0": (-0.615, -0.982), "middle_1": (-0.847, -1.014),
    "index_0": (-0.615, -0.982), "index_1": (-0.847, -1.014),
}  # fmt: skip
_SIGNS = {"left": 1.0, "right": -1.0}
"""The right hand is the mirror image of the left."""
_TIPS = {"thumb": "thumb_2", "middle": "middle_1", "index": "index_1"}


def _part(side: str) -> RobotPart:
    sign = _SIGNS[side]
    name, prefix = f"dex3_{side}", f"{side}_hand_"

    def articulation() -> Articulation:
        robot = installed_urdf(SOURCE, "robots/g1_description/urdf/g1_29dof_with_hand_rev_1_0.urdf")
        hand = with_frames(subtree(robot, f"{prefix}palm_link"), side)
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


def with_frames(robot: Articulation, side: str) -> Articulation:
    """The robot with frames on its hand of that side, as the hand's part names them: between the tips, and at each."""
    sign, prefix = _SIGNS[side], f"{side}_hand_"
    tips = (
        Frame(f"{prefix}{tip}_tip", f"{prefix}{link}_link", Pose(_tip_of(tip, sign))) for tip, link in _TIPS.items()
    )
    tcp = Frame(f"dex3_{side}_tcp", f"{prefix}palm_link", bracket(*_seat(sign)) @ Pose((0.0, -0.006, 0.1087)))
    return add_frames(robot, tcp, *tips)


def _seat(sign: float) -> tuple[Vector3, Vector3, Vector3, float]:
    return (0.0435, 0.0214 * sign, 0.0), (1.0, 0.0, 0.0), (0.0, -sign, 0.0), 70.0


def _tip_of(finger: str, sign: float) -> tuple[float, float, float]:
    """The middle of the last link's rounded end, in that link."""
    return (0.0, -0.042 * sign, 0.0) if finger == "thumb" else (0.042, 0.0, 0.0)


LEFT, RIGHT = _part("left"), _part("right")
