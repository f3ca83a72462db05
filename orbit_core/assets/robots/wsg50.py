"""Schunk WSG 50 with 110 mm of opening, a gripper with two parallel jaws, to be attached to arms."""

from __future__ import annotations

import math

from orbit_core.assets.cache import Model
from orbit_core.assets.inertia import combine, mass_properties
from orbit_core.assets.meshes import load_mesh
from orbit_core.assets.parts import PartKind, RobotPart
from orbit_core.assets.sources import model_folder
from orbit_core.scene import Articulation, Box, Frame, Gripper, ImplicitPd, Joint, JointType, Link, Mimic, Pose, Shape

SOURCE = "pybullet"
BODY_MASS, FINGER_MASS = 1.2, 0.2
JOINTS = ("wsg50_finger_left_joint", "wsg50_finger_right_joint")
NOTE = (
    "WSG 50: of the package's SDF file only the meshes and masses are kept; inertias are those of its collision boxes "
    "(the file has 0.1 and 1 kg m^2), its linkage of hinges is two prismatic joints, 80 N and 0.42 m/s as the maker's"
)


def gripper() -> Articulation:
    """The gripper from its flange on, z out of the hand, the fingers closing along y."""
    folder = model_folder(SOURCE) / "pybullet_data/gripper/meshes"
    across = Pose.from_euler(0.0, 0.0, math.pi / 2)  # the meshes open along x
    shell = Shape(Box((0.025, 0.073, 0.03625)), Pose((0.0, 0.0, 0.03625)), name="body")
    body = mass_properties(shell.geometry, mass=BODY_MASS).placed(shell.pose)
    picture = Shape(load_mesh(folder / "WSG50_110.stl"), across, color=(0.6, 0.6, 0.62, 1.0))
    base = Link("wsg50_base", BODY_MASS, body.center_of_mass, body.inertia, (shell,), (picture,))
    links, joints = [base], []
    for joint, side in zip(JOINTS, (1.0, -1.0), strict=True):
        turn = Pose.from_euler(0.0, 0.0, -side * math.pi / 2)  # a finger's mesh has its pad towards +x
        carriage = Shape(Box((0.015, 0.009, 0.0185)), Pose((0.0, 0.009 * side, 0.078)), name="carriage")
        # 23 mm deep at its foot, 5 mm at the pad: one flat box along the whole finger.
        pad = Shape(Box((0.012, 0.005, 0.0365)), Pose((0.0, 0.005 * side, 0.101)), name="pad")
        seen = tuple(
            Shape(load_mesh(folder / name, (0.001, 0.001, 0.001)), turn, color=color)
            for name, color in (
                ("GUIDE_WSG50_110.stl", (0.3, 0.3, 0.32, 1.0)),
                ("WSG-FMF.stl", (0.75, 0.75, 0.75, 1.0)),
            )
        )
        mass = combine(mass_properties(s.geometry, mass=FINGER_MASS / 2).placed(s.pose) for s in (carriage, pad))
        link = joint.removesuffix("_joint")
        links.append(Link(link, FINGER_MASS, mass.center_of_mass, mass.inertia, (carriage, pad), seen))
        joints.append(
            Joint(
                joint,
                JointType.PRISMATIC,
                base.name,
                link,
                axis=(0.0, side, 0.0),
                lower_limit=0.0,
                upper_limit=0.055,
                effort_limit=80.0,
                velocity_limit=0.42,
                armature=0.2,
                mimic=None if joint == JOINTS[0] else Mimic(JOINTS[0]),
            )
        )
    tcp = Frame("wsg50_tcp", base.name, Pose((0.0, 0.0, 0.12)))
    return Articulation("wsg50", tuple(links), tuple(joints), (tcp,), notes=(NOTE,))


PART = RobotPart(
    name="wsg50",
    kind=PartKind.END_EFFECTOR,
    model=Model("wsg50", gripper, (SOURCE,), "zlib"),
    home=dict.fromkeys(JOINTS, 0.05),
    drives=(ImplicitPd(joints=JOINTS[:1], stiffness=4000.0, damping=120.0),),
    frame="wsg50_tcp",
    gripper=Gripper(JOINTS[:1], 0.05, 0.0),
)
