"""Schunk WSG 50 with 110 mm of opening, a gripper with two parallel jaws, to be attached to arms."""

from __future__ import annotations

import math
from functools import partial
from pathlib import Path

from orbit_assets.cache import Model
from orbit_assets.compose import inertia_of_shapes
from orbit_assets.meshes import load_mesh
from orbit_assets.parts import PartKind, RobotPart
from orbit_assets.sources import model_folder
from orbit_core.scene import Articulation, Box, Frame, Gripper, ImplicitPd, Joint, JointType, Link, Mimic, Pose, Shape

SOURCE = "pybullet"
JOINTS = ("wsg50_finger_left_joint", "wsg50_finger_right_joint")
_LIMITED = partial(Joint, lower_limit=0.0, upper_limit=0.055, effort_limit=80.0, velocity_limit=0.42, armature=0.2)
LOOKS = (("GUIDE_WSG50_110.stl", (0.3, 0.3, 0.32, 1.0)), ("WSG-FMF.stl", (0.75, 0.75, 0.75, 1.0)))
NOTE = (
    "WSG 50: of the package's SDF file only the meshes and masses are kept (its inertias are 0.1 and 1 kg m^2); its "
    "linkage of hinges is two prismatic joints, 80 N and 0.42 m/s as the maker's"
)


def gripper() -> Articulation:
    """The gripper from its flange on, z out of the hand, the fingers closing along y."""
    across = Pose.from_euler(0.0, 0.0, math.pi / 2)  # the meshes open along x
    shell = Shape(Box((0.025, 0.073, 0.03625)), Pose((0.0, 0.0, 0.03625)), name="body")
    picture = Shape(load_mesh(_meshes() / "WSG50_110.stl"), across, color=(0.6, 0.6, 0.62, 1.0))
    base = Link("wsg50_base", 1.2, collisions=(shell,), visuals=(picture,))
    fingers, joints = zip(*map(_finger, JOINTS, (1.0, -1.0)), strict=True)
    tcp = Frame("wsg50_tcp", base.name, Pose((0.0, 0.0, 0.12)))
    return inertia_of_shapes(Articulation("wsg50", (base, *fingers), joints, (tcp,), notes=(NOTE,)), ("wsg50_.*",))


def _finger(name: str, side: float) -> tuple[Link, Joint]:
    turn = Pose.from_euler(0.0, 0.0, -side * math.pi / 2)  # a finger's mesh has its pad towards +x
    carriage = Shape(Box((0.015, 0.009, 0.0185)), Pose((0.0, 0.009 * side, 0.078)), name="carriage")
    # 23 mm deep at its foot, 5 mm at the pad: one flat box along the whole finger.
    pad = Shape(Box((0.012, 0.005, 0.0365)), Pose((0.0, 0.005 * side, 0.101)), name="pad")
    seen = tuple(Shape(load_mesh(_meshes() / m, (1e-3, 1e-3, 1e-3)), turn, color=color) for m, color in LOOKS)
    link = Link(name.removesuffix("_joint"), 0.2, collisions=(carriage, pad), visuals=seen)
    follows, axis = None if name == JOINTS[0] else Mimic(JOINTS[0]), (0.0, side, 0.0)
    return link, _LIMITED(name, JointType.PRISMATIC, "wsg50_base", link.name, axis=axis, mimic=follows)


def _meshes() -> Path:
    return model_folder(SOURCE) / "pybullet_data/gripper/meshes"


PART = RobotPart(
    name="wsg50",
    kind=PartKind.END_EFFECTOR,
    model=Model("wsg50", gripper, (SOURCE,), "zlib", parts=(inertia_of_shapes,)),
    home=dict.fromkeys(JOINTS, 0.05),
    drives=(ImplicitPd(joints=JOINTS[:1], stiffness=4000.0, damping=120.0),),
    frame="wsg50_tcp",
    gripper=Gripper(JOINTS[:1], 0.05, 0.0),
)
