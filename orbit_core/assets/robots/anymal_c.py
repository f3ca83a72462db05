"""ANYbotics ANYmal C, a quadruped with twelve joints."""

from __future__ import annotations

from orbit_core.assets.cache import Model, cached_articulation
from orbit_core.assets.installed import installed_urdf
from orbit_core.scene import Articulation, ImplicitPd, Pose, RobotSpec

SOURCE = "example-robot-data"
LICENCE = "BSD-3-Clause"
HOME = {".*_HAA": 0.0, ".F_HFE": 0.4, ".H_HFE": -0.4, ".F_KFE": -0.8, ".H_KFE": 0.8}
# Gains of Rudin et al., Learning to Walk in Minutes (2021); effort and velocity limits are the URDF's.
LEGS = ImplicitPd(joints=(".*",), stiffness=80.0, damping=2.0)


def build() -> RobotSpec:
    """The robot standing, its base 0.6 m above the ground: the feet are let down a little way.

    Its feet are part of the shanks; a frame of each foot's name (``LF_FOOT`` ...) marks where they are.
    """
    return RobotSpec(
        name="anymal_c",
        articulation=cached_articulation(Model("anymal_c", _articulation, (SOURCE,), LICENCE)),
        pose=Pose((0.0, 0.0, 0.6)),
        home=HOME,
        actuators=(LEGS,),
        semantic_label="robot",
        feet=("LF_FOOT", "RF_FOOT", "LH_FOOT", "RH_FOOT"),
        licence=LICENCE,
        source=SOURCE,
    )


def _articulation() -> Articulation:
    return installed_urdf(SOURCE, "robots/anymal_c_simple_description/urdf/anymal.urdf", "anymal_c")
