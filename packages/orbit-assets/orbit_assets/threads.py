"""Bolts and nuts with a right-handed metric thread, as meshes whose threads mesh.

The profile is the basic one of ISO 68-1: flanks of 60 degrees, crests cut by an eighth of the fundamental triangle's
height, roots by a quarter. For engines without signed distance fields there are square threads of boxes along the
helix, of the same radii and lead.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NotRequired, TypedDict

import numpy as np
import numpy.typing as npt

from orbit_assets.objects import solid_link
from orbit_assets.pegs import prism
from orbit_core.interfaces.errors import AssetError
from orbit_core.scene import (
    Articulation,
    Box,
    Color,
    Mesh,
    MeshCollision,
    ObjectSpec,
    PhysicsMaterial,
    Pose,
    Shape,
)

# Rows of vertices per turn of a thread: ten resolve its profile of eighths.
_ROWS = 10
# Vertices around the axis: chords are within 0.02 mm of an M16's circle.
_AROUND = 48
# Boxes in each turn of a thread of boxes.
_BOXES = 12
# Metres below which engines generate contacts between boxes of threads.
_NEAR = 1e-3
# Density in kg/m^3.
_STEEL = 7800.0
# Metres of a nut's wall outside its thread that belong to the field of distances.
_WALL = 0.002


@dataclass(frozen=True, kw_only=True)
class Thread:
    """A single-start thread; the defaults are those of M16."""

    radius: float = 0.008
    """Metres, of the crests of the bolt."""
    lead: float = 0.002
    """Metres that a nut moves along the axis in a turn."""

    @property
    def minor_radius(self) -> float:
        """Metres, of the roots: five eighths of the fundamental triangle's height below the crests."""
        return self.radius - 0.625 * 0.5 * math.sqrt(3.0) * self.lead

    def radii(self, angles: npt.NDArray[np.float64], heights: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
        """Return the radius of the bolt's surface (m) at angles about its axis (rad) and heights along it (m)."""
        # The profile of ISO 68-1 over one lead: crest 1/8, flanks 5/16 each, root 1/4.
        phase = (heights / self.lead - angles / (2.0 * math.pi)) % 1.0
        rise = np.clip((0.375 - np.abs(phase - 0.5)) / 0.3125, 0.0, 1.0)
        return self.minor_radius + (self.radius - self.minor_radius) * rise


class ThreadOptions(TypedDict):
    """Options of bolts and nuts other than their shape."""

    material: PhysicsMaterial
    """Material of all parts."""
    boxes: NotRequired[bool]
    """True if threads collide as :func:`bolt_boxes` and :func:`nut_boxes`, instead of by signed distance fields."""


def bolt(length: float, thread: Thread = Thread()) -> Mesh:
    """Build a threaded rod along z that stands on the origin; its last turn is a pilot of the roots' radius.

    Args:
        length: metres.
        thread: the thread on it.

    Raises:
        AssetError: it is shorter than two turns, or the roots have no radius.
    """
    _check(length, thread)
    heights = _heights(length, thread)
    grid, angles = np.meshgrid(heights, _angles(), indexing="ij")
    # The pilot lets a nut find the axis before threads engage.
    pilot = grid > length - thread.lead
    rows = _rows(np.where(pilot, thread.minor_radius, thread.radii(angles, grid)), heights)
    ends = np.array(((0.0, 0.0, 0.0), (0.0, 0.0, length)))
    count, last, k = len(rows), len(rows) - _AROUND, np.arange(_AROUND)
    after = (k + 1) % _AROUND
    below = np.stack((np.full(_AROUND, count), after, k), 1)
    above = np.stack((np.full(_AROUND, count + 1), last + k, last + after), 1)
    faces = np.concatenate((_sides(len(heights)), below, above))
    return Mesh(np.concatenate((rows, ends)), faces, MeshCollision.SIGNED_DISTANCE)


def nut(height: float, outer_radius: float, thread: Thread = Thread(), *, clearance: float = 1e-4) -> Mesh:
    """Build a round nut about z that stands on the origin, in phase with :func:`bolt` at whole leads above it.

    Args:
        height: metres.
        outer_radius: metres.
        thread: that of the bolt.
        clearance: metres by which the radius of its thread exceeds the bolt's.

    Raises:
        AssetError: it is lower than two turns, the roots have no radius, there is no clearance, or too thin a wall.
    """
    _check(height, thread)
    if not 0.0 < clearance < outer_radius - thread.radius:
        raise AssetError(
            f"a nut of {1e3 * outer_radius:g} mm outer radius on a thread of {1e3 * thread.radius:g} mm cannot have a "
            f"clearance of {1e3 * clearance:g} mm: give one above zero that leaves a wall"
        )
    heights = _heights(height, thread)
    grid, angles = np.meshgrid(heights, _angles(), indexing="ij")
    inner = _rows(thread.radii(angles, grid) + clearance, heights)
    outer = _rows(np.full_like(grid, outer_radius), heights)
    count, last, k = len(inner), len(inner) - _AROUND, np.arange(_AROUND)
    after, sides = (k + 1) % _AROUND, _sides(len(heights))
    below = [np.stack((k, after, count + after), 1), np.stack((k, count + after, count + k), 1)]
    above = [last + side[:, ::-1] for side in below]
    faces = np.concatenate((sides[:, ::-1], count + sides, *below, *above))
    return Mesh(np.concatenate((inner, outer)), faces, MeshCollision.SIGNED_DISTANCE)


def bolt_boxes(length: float, thread: Thread, material: PhysicsMaterial) -> tuple[Shape, ...]:
    """Build boxes in place of :func:`bolt`: a ridge half a lead wide around a core of the roots' radius."""
    half = thread.minor_radius / math.sqrt(2.0)
    core = Box((half, half, 0.5 * length))
    # Two square prisms, an eighth of a turn apart, are an octagonal core.
    across = (math.cos(math.pi / 8.0), 0.0, 0.0, math.sin(math.pi / 8.0))
    cores = [Shape(core, Pose((0.0, 0.0, 0.5 * length), turn), material) for turn in ((1.0, 0.0, 0.0, 0.0), across)]
    ridge = _ridge(thread, (half, thread.radius), 0.5 * thread.lead, (0.0, length - thread.lead), 0.5, material)
    return (*cores, *ridge)


def nut_boxes(
    height: float, outer_radius: float, thread: Thread, material: PhysicsMaterial, *, clearance: float
) -> tuple[Shape, ...]:
    """Build boxes in place of the thread of :func:`nut`: a ridge in the groove of the bolt's.

    It is narrower than the groove by ``clearance`` (metres), and as much further from the axis than the bolt's core.
    """
    radii = (thread.minor_radius + clearance, outer_radius)
    width = 0.5 * thread.lead - clearance
    return _ridge(thread, radii, width, (0.0, height - 0.5 * width), 0.0, material)


def bolt_on_base(
    name: str,
    length: float,
    thread: Thread,
    *,
    base: float,
    color: Color,
    material: PhysicsMaterial,
    boxes: bool = False,
) -> ObjectSpec:
    """Build a bolt that stands on a fixed square base 80 mm wide; its frame is in the middle of the base's underside.

    Args:
        name: of the object in its scene.
        length: metres of the bolt above the base.
        thread: the bolt's.
        base: metres of the base's height.
        color: of both.
        material: of both.
        boxes: whether its thread collides as :func:`bolt_boxes` do, and not as the field of distances of :func:`bolt`.

    Raises:
        AssetError: as :func:`bolt`.
    """
    half = 0.5 * base
    foot = Shape(Box((0.04, 0.04, half)), Pose((0.0, 0.0, half)), material, color, "base")
    rod = Shape(bolt(length, thread), Pose((0.0, 0.0, base)), material, color, "bolt")
    link = solid_link(name, (foot, rod), _STEEL)
    # The mass stays that of the mesh: boxes overlap, and their volumes would count twice.
    if boxes:
        link = replace(link, collisions=(foot, *_placed(bolt_boxes(length, thread, material), rod.pose)))
    return ObjectSpec(name=name, articulation=Articulation(name, (link,)), fixed_base=True, semantic_label="bolt")


def hexagonal_nut(
    name: str,
    height: float,
    width: float,
    thread: Thread,
    *,
    clearance: float,
    color: Color,
    material: PhysicsMaterial,
    boxes: bool = False,
) -> ObjectSpec:
    """Build a nut of six flat sides; its frame is in the middle of its underside, x towards a corner.

    The thread collides by its field of distances and ends 0.5 mm within the faces; what grippers and tables touch are
    six prisms around it.

    Args:
        name: of the object in its scene.
        height: metres.
        width: metres across the flats.
        thread: that of the bolt.
        clearance: metres by which the radius of its thread exceeds the bolt's.
        color: of the nut.
        material: of all of it.
        boxes: whether its thread collides as :func:`nut_boxes` do, with half the clearance.

    Raises:
        AssetError: as :func:`nut`.
    """
    inner, outer = thread.radius + clearance + _WALL, width / math.sqrt(3.0)
    ring = nut(height - 1e-3, inner, thread, clearance=clearance)
    # Half a millimetre within the faces: else thread and prisms would touch the table together.
    shapes = [Shape(ring, Pose((0.0, 0.0, 5e-4)), material, color, "thread")]
    for k in range(6):
        first, second = (
            np.array((math.cos(angle), math.sin(angle))) for angle in (k * math.pi / 3, (k + 1) * math.pi / 3)
        )
        sides = np.stack((inner * first, outer * first, outer * second, inner * second))
        geometry, pose = prism(sides, height)
        shapes.append(Shape(geometry, pose, material, color, f"side_{k}"))
    link = solid_link(name, shapes, _STEEL)
    if boxes:
        ridge = nut_boxes(height - 1e-3, inner, thread, material, clearance=0.5 * clearance)
        link = replace(link, collisions=(*_placed(ridge, shapes[0].pose), *link.collisions[1:]))
    return ObjectSpec(name=name, articulation=Articulation(name, (link,)), semantic_label="nut")


def _placed(shapes: Sequence[Shape], pose: Pose) -> tuple[Shape, ...]:
    return tuple(replace(shape, pose=pose @ shape.pose) for shape in shapes)


def _ridge(
    thread: Thread,
    radii: tuple[float, float],
    width: float,
    heights: tuple[float, float],
    phase: float,
    material: PhysicsMaterial,
) -> tuple[Shape, ...]:
    """Build boxes between two radii (m), ``width`` metres high, along the helix ``phase`` leads high at angle 0."""
    shapes: list[Shape] = []
    middle, half = 0.5 * sum(radii), math.pi / _BOXES
    slope = 0.5 * math.atan(
        thread.lead / (math.pi * (thread.minor_radius + thread.radius))
    )  # half the helix angle at the radius where threads meet, as in a quaternion
    box = Box((0.5 * (radii[1] - radii[0]), thread.radius * math.tan(half), 0.5 * width))
    for number in range(-_BOXES, math.ceil(heights[1] / thread.lead) * _BOXES):
        angle, height = 2.0 * half * number, thread.lead * (number / _BOXES + phase)
        if heights[0] + 0.5 * width <= height <= heights[1]:
            c, s = math.cos(half * number), math.sin(half * number)
            turn = (c * math.cos(slope), c * math.sin(slope), s * math.sin(slope), s * math.cos(slope))
            place = (middle * math.cos(angle), middle * math.sin(angle), height)
            shapes.append(Shape(box, Pose(place, turn), material, contact_distance=_NEAR))
    return tuple(shapes)


def _check(length: float, thread: Thread) -> None:
    if not (length >= 2.0 * thread.lead > 0.0 and thread.minor_radius > 0.0):
        raise AssetError(
            f"{thread} on {1e3 * length:g} mm cannot be: give a length of two leads or more, and a lead below "
            f"{1e3 * thread.radius / 0.5413:.3g} mm, which leaves roots with a radius"
        )


def _angles() -> npt.NDArray[np.float64]:
    return 2.0 * math.pi * np.arange(_AROUND) / _AROUND


def _heights(length: float, thread: Thread) -> npt.NDArray[np.float64]:
    return np.linspace(0.0, length, math.ceil(_ROWS * length / thread.lead) + 1)


def _rows(radii: npt.NDArray[np.float64], heights: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
    """Return vertices (rows * around, 3) at radii (rows, around)."""
    up = np.broadcast_to(heights[:, None], radii.shape)
    return np.stack((radii * np.cos(_angles()), radii * np.sin(_angles()), up), -1).reshape(-1, 3)


def _sides(rows: int) -> npt.NDArray[np.int64]:
    """Return faces between rows of vertices, seen from outside."""
    k = np.arange(_AROUND)
    low = (np.arange(rows - 1)[:, None] * _AROUND + k).ravel()
    after = (np.arange(rows - 1)[:, None] * _AROUND + (k + 1) % _AROUND).ravel()
    first = np.stack((low, after, after + _AROUND), 1)
    second = np.stack((low, after + _AROUND, low + _AROUND), 1)
    return np.concatenate((first, second))
