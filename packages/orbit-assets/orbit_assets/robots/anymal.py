"""ANYbotics ANYmal B and C, quadrupeds with twelve joints."""

from __future__ import annotations

from orbit_assets.cache import Model
from orbit_assets.compose import add_frames
from orbit_assets.drive_design import with_armature
from orbit_assets.robot_parts import PartKind, RobotPart
from orbit_assets.sources import installed_urdf
from orbit_core.preparation.merge import merge_fixed_links
from orbit_core.scene import Articulation, Frame, ImplicitPd, Pose

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
