"""The hand of the Franka Emika Panda, with two parallel jaws."""

from __future__ import annotations

from orbit_assets.cache import Model
from orbit_assets.compose import subtree
from orbit_assets.installed import installed_urdf
from orbit_assets.parts import PartKind, RobotPart
from orbit_assets.robots.franka_panda import FILE, LICENCE, SOURCE, simplified
from orbit_core.preparation.merge import merge_fixed_links
from orbit_core.scene import Articulation, Gripper, ImplicitPd


def hand() -> Articulation:
    """The hand; its frame ``panda_hand_tcp`` lies between the finger pads, 0.1034 m out of its root."""
    return simplified(merge_fixed_links(subtree(installed_urdf(SOURCE, FILE), "panda_hand")))


PART = RobotPart(
    name="panda_hand",
    kind=PartKind.END_EFFECTOR,
    model=Model("panda_hand", hand, (SOURCE,), LICENCE, parts=(simplified,)),
    home={"panda_finger_joint.*": 0.04},
    drives=(ImplicitPd(joints=("panda_finger_joint1",), stiffness=2000.0, damping=100.0),),
    frame="panda_hand_tcp",
    gripper=Gripper(("panda_finger_joint1",), 0.04, 0.0),
)
