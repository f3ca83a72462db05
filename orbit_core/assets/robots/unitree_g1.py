"""Unitree G1, a humanoid with 29 joints, and the same with Dex3 hands."""

from __future__ import annotations

from collections.abc import Mapping

from orbit_core.assets.cache import Model
from orbit_core.assets.compose import simplify_collisions
from orbit_core.assets.installed import installed_urdf
from orbit_core.assets.merge import merge_fixed_links
from orbit_core.assets.parts import PartKind, RobotPart
from orbit_core.dynamics.drive_design import DriveDesign, with_armature
from orbit_core.scene import Articulation, ImplicitPd, Pose

SOURCE = "example-robot-data"
LICENCE = "BSD-3-Clause"
HOME = {".*_hip_pitch_joint": -0.1, ".*_knee_joint": 0.3, ".*_ankle_pitch_joint": -0.2, ".*_elbow_joint": 0.9}
ARMS = (".*_(shoulder|elbow|wrist)_.*joint",)
FINGERS = (".*_hand_.*_joint",)
# Hips and knees as in Unitree's own reinforcement learning code (unitree_rl_gym: 100 to 150 N m/rad). Its ankles have
# 40 and need a policy to stand: a standing body of mass m, h above its ankles, falls where these have less than
# m g h = 34 kg * 9.81 m/s^2 * 0.65 m = 217 N m/rad together.
LEGS = (
    ImplicitPd(joints=(".*_hip_.*_joint",), stiffness=1000.0, damping=25.0),
    ImplicitPd(joints=(".*_knee_joint",), stiffness=1000.0, damping=25.0),
    ImplicitPd(joints=(".*_ankle_.*_joint",), stiffness=1000.0, damping=25.0),
    ImplicitPd(joints=("waist_.*_joint",), stiffness=1000.0, damping=25.0),
)


def _part(name: str, file: str, designs: tuple[DriveDesign, ...], home: Mapping[str, float]) -> RobotPart:
    def articulation() -> Articulation:
        source = installed_urdf(SOURCE, f"robots/g1_description/urdf/{file}.urdf", name)
        return with_armature(simplify_collisions(merge_fixed_links(source)))

    return RobotPart(
        name=name,
        kind=PartKind.BASE,
        model=Model(name, articulation, (SOURCE,), LICENCE, parts=(with_armature,)),
        home=home,
        drives=LEGS,
        designs=designs,
        feet=("left_ankle_roll_link", "right_ankle_roll_link"),
        pose=Pose((0.0, 0.0, 0.79)),
        fixed_base=False,
    )


G1 = _part("unitree_g1", "g1_29dof_rev_1_0", (DriveDesign(joints=ARMS),), HOME)
G1_DEX3 = _part(
    "unitree_g1_dex3", "g1_29dof_with_hand_rev_1_0", (DriveDesign(joints=ARMS), DriveDesign(joints=FINGERS)), HOME
)
