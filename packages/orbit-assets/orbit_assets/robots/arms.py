"""Arms without an end effector of their own: KUKA LBR iiwa 7, UFACTORY xArm 7, Universal Robots UR5 and UR10."""

from __future__ import annotations

import math

from orbit_assets.cache import Model
from orbit_assets.compose import add_frames, edit_joints, simplify_collisions, subtree
from orbit_assets.drive_design import DriveDesign, with_armature
from orbit_assets.robot_parts import PartKind, RobotPart
from orbit_assets.sources import installed_urdf
from orbit_core.preparation.merge import merge_fixed_links
from orbit_core.scene import Articulation, Frame, Pose, Workspace

KUKA_SOURCE = "pybullet"


KUKA_FLANGE = Frame("flange", "lbr_iiwa_link_7", Pose.from_euler(0.0, 0.0, -math.pi / 2, (0.0, 0.0, 0.045)))


def kuka_iiwa7() -> Articulation:
    """Read the arm up to the frame ``flange`` on its last link, 45 mm out, with z out of it."""
    source = installed_urdf(KUKA_SOURCE, "pybullet_data/kuka_iiwa/model.urdf", "kuka_iiwa7")
    arm = simplify_collisions(merge_fixed_links(source))
    note = "velocity limit of 1.71 rad/s, the maker's for its slowest axes: the URDF has 10 rad/s on all"
    arm = edit_joints(arm, (".*",), note, velocity_limit=1.71)
    return with_armature(add_frames(arm, KUKA_FLANGE))


KUKA_IIWA7 = RobotPart(
    name="kuka_iiwa7",
    kind=PartKind.ARM,
    model=Model("kuka_iiwa7", kuka_iiwa7, (KUKA_SOURCE,), "zlib", parts=(with_armature,)),
    home={
        "lbr_iiwa_joint_1": -0.162,
        "lbr_iiwa_joint_2": 0.275,
        "lbr_iiwa_joint_3": 0.203,
        "lbr_iiwa_joint_4": -1.547,
        "lbr_iiwa_joint_5": -0.057,
        "lbr_iiwa_joint_6": 1.325,
        "lbr_iiwa_joint_7": -1.523,
    },
    designs=(DriveDesign(joints=("lbr_iiwa_joint_[1-7]",)),),
    mount="flange",
    workspace=Workspace(),
    joints=("lbr_iiwa_joint_[1-7]",),
)


SOURCE = "example-robot-data"


def xarm7() -> Articulation:
    """Read the arm up to the frame ``flange``, which is ``link_eef`` turned: z out of it, y across at home."""
    source = subtree(installed_urdf(SOURCE, "robots/xarm_description/urdf/xarm7.urdf"), "link_base", "xarm7")
    arm = with_armature(simplify_collisions(merge_fixed_links(source)))
    return add_frames(arm, Frame("flange", "link_eef", Pose.from_euler(0.0, 0.0, -math.pi / 2)))


XARM7 = RobotPart(
    name="xarm7",
    kind=PartKind.ARM,
    model=Model("xarm7", xarm7, (SOURCE,), "BSD-3-Clause", parts=(with_armature,)),
    home={
        "joint1": -0.183,
        "joint2": -0.269,
        "joint3": 0.162,
        "joint4": 1.01,
        "joint5": 0.045,
        "joint6": 1.276,
        "joint7": 1.531,
    },
    designs=(DriveDesign(joints=("joint[1-7]",)),),
    mount="flange",
    joints=("joint[1-7]",),
    workspace=Workspace((0.35, -0.2, 0.1), (0.55, 0.2, 0.35)),
)


UR_JOINTS = (
    "shoulder_pan_joint", "shoulder_lift_joint", "elbow_joint", "wrist_1_joint", "wrist_2_joint", "wrist_3_joint",
)  # fmt: skip


def _universal_robot(name: str, workspace: Workspace, home: tuple[float, ...]) -> RobotPart:
    def articulation() -> Articulation:
        source = installed_urdf(SOURCE, f"robots/ur_description/urdf/{name}_robot.urdf", name)
        arm = with_armature(simplify_collisions(merge_fixed_links(subtree(source, "base_link", name))))
        return add_frames(arm, Frame("flange", "tool0", Pose.from_euler(0.0, 0.0, -math.pi / 2)))

    return RobotPart(
        name=name,
        kind=PartKind.ARM,
        model=Model(name, articulation, (SOURCE,), "BSD", parts=(with_armature,)),
        home=dict(zip(UR_JOINTS, home, strict=True)),
        designs=(DriveDesign(joints=UR_JOINTS),),
        mount="flange",
        joints=UR_JOINTS,
        workspace=workspace,
    )


UR5 = _universal_robot(
    "ur5",
    Workspace((0.35, -0.25, 0.15), (0.6, 0.25, 0.45)),
    (-0.245, -1.227, 1.372, -1.716, -1.571, -0.245),
)
UR10 = _universal_robot(
    "ur10",
    Workspace((0.6, -0.25, 0.15), (0.9, 0.25, 0.5)),
    (-0.277, -1.739, 1.91, -1.742, -1.571, -0.277),
)
"""Their ``flange`` is ``tool0`` turned: z out of it, y across at home."""
