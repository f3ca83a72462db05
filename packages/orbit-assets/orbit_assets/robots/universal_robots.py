"""Universal Robots UR5 and UR10, arms of six joints."""

from __future__ import annotations

import math

from orbit_assets.cache import Model
from orbit_assets.compose import add_frames, simplify_collisions, subtree
from orbit_assets.drive_design import DriveDesign, with_armature
from orbit_assets.installed import installed_urdf
from orbit_assets.parts import PartKind, RobotPart
from orbit_core.preparation.merge import merge_fixed_links
from orbit_core.scene import Articulation, Frame, Pose, Workspace

SOURCE = "example-robot-data"
JOINTS = (
    "shoulder_pan_joint", "shoulder_lift_joint", "elbow_joint", "wrist_1_joint", "wrist_2_joint", "wrist_3_joint",
)  # fmt: skip


def _part(name: str, workspace: Workspace, home: tuple[float, ...]) -> RobotPart:
    def articulation() -> Articulation:
        source = installed_urdf(SOURCE, f"robots/ur_description/urdf/{name}_robot.urdf", name)
        arm = with_armature(simplify_collisions(merge_fixed_links(subtree(source, "base_link", name))))
        return add_frames(arm, Frame("flange", "tool0", Pose.from_euler(0.0, 0.0, -math.pi / 2)))

    return RobotPart(
        name=name,
        kind=PartKind.ARM,
        model=Model(name, articulation, (SOURCE,), "BSD", parts=(with_armature,)),
        home=dict(zip(JOINTS, home, strict=True)),
        designs=(DriveDesign(joints=JOINTS),),
        mount="flange",
        joints=JOINTS,
        workspace=workspace,
    )


UR5 = _part(
    "ur5",
    Workspace((0.35, -0.25, 0.15), (0.6, 0.25, 0.45)),
    (-0.245, -1.227, 1.372, -1.716, -1.571, -0.245),
)
UR10 = _part(
    "ur10",
    Workspace((0.6, -0.25, 0.15), (0.9, 0.25, 0.5)),
    (-0.277, -1.739, 1.91, -1.742, -1.571, -0.277),
)
"""Their ``flange`` is ``tool0`` turned: z out of it, y across at home."""
