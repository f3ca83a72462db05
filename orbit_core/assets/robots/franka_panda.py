"""Franka Emika Panda with its hand."""

from __future__ import annotations

from orbit_core.assets.cache import Model, cached_articulation
from orbit_core.assets.compose import edit_joints, simplify_collisions
from orbit_core.assets.installed import installed_urdf
from orbit_core.assets.merge import merge_fixed_links
from orbit_core.scene import Articulation, EndEffector, Gripper, ImplicitPd, RobotSpec

SOURCE = "example-robot-data"
LICENCE = "Apache-2.0"
HOME = {
    "panda_joint1": 0.0,
    "panda_joint2": -0.569,
    "panda_joint3": 0.0,
    "panda_joint4": -2.810,
    "panda_joint5": 0.0,
    "panda_joint6": 3.037,
    "panda_joint7": 0.741,
    "panda_finger_joint.*": 0.04,
}
ARM = ImplicitPd(joints=("panda_joint[1-7]",), stiffness=400.0, damping=80.0)
HAND = ImplicitPd(joints=("panda_finger_joint1",), stiffness=2000.0, damping=100.0)


def build() -> RobotSpec:
    """The arm before its base, the open hand tilted 46 degrees forward from straight down.

    The end effector's frame lies between the finger pads, 0.1034 m out of ``panda_hand``.
    """
    return RobotSpec(
        name="franka_panda",
        articulation=cached_articulation(Model("franka_panda", _articulation, (SOURCE,), LICENCE)),
        fixed_base=True,
        home=HOME,
        actuators=(ARM, HAND),
        semantic_label="robot",
        gravity_compensation=True,
        end_effectors=(
            EndEffector("panda_hand_tcp", ("panda_joint[1-7]",), Gripper(("panda_finger_joint1",), 0.04, 0.0)),
        ),
        licence=LICENCE,
        source=SOURCE,
    )


def _articulation() -> Articulation:
    source = installed_urdf(SOURCE, "robots/panda_description/urdf/panda.urdf", "franka_panda")
    arm = merge_fixed_links(source)
    # The URDF leaves the motors' inertia out. 0.1 is that of a 10 kg mm^2 rotor behind a gear of 100:1; the fingers
    # (15 g) get as many kg, so that the drive and the contact forces act on bodies of like weight.
    note = "armature of 0.1 kg m^2 (arm) and 0.1 kg (fingers) is the catalogue's choice: the URDF has none"
    return simplify_collisions(edit_joints(arm, (".*",), note, armature=0.1))
