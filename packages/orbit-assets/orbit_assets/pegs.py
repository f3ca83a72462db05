"""Blocks of several sections and a board with a matching hole for each, all of boxes, cylinders and convex prisms.

Every engine has these shapes as they are, so that a tight fit is the same on each.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from orbit_assets.objects import DENSITY, WOOD, solid_link
from orbit_core.interfaces.errors import AssetError, UnknownNameError
from orbit_core.scene import (
    Articulation,
    Box,
    Capsule,
    Color,
    Cylinder,
    Frame,
    Geometry,
    Mesh,
    ObjectSpec,
    PhysicsMaterial,
    Pose,
    Shape,
)
from orbit_core.scene.pose import Vector3

# Bent rods on two stands, and rings on a handle that go along them, both of capsules ----------------------------------
# Every engine has capsules as they are, so that a ring touches its rod at the same distance on each.

# Points to a piece of a spline, between which it is taken as straight.
_FINE = 100
_STEEL: Color = (0.72, 0.74, 0.78, 1.0)
_BRASS: Color = (0.85, 0.62, 0.2, 1.0)


@dataclass(frozen=True, eq=False)
class Course:
    """Points (K, 3) in metres, equally far apart along a curve, and the curve's unit tangents (K, 3) there."""

    points: npt.NDArray[np.float64]
    """(K, 3) m."""
    tangents: npt.NDArray[np.float64]
    """(K, 3) unit vectors."""
    spacing: float
    """Metres along the curve from a point to the next."""

    def part(self, margin: float) -> Course:
        """Return the course without ``margin`` metres at either end, to the next point."""
        cut = round(margin / self.spacing)
        return Course(
            self.points[cut : len(self.points) - cut], self.tangents[cut : len(self.points) - cut], self.spacing
        )


def spline(corners: Sequence[Vector3], spacing: float) -> Course:
    """Return the curve through all ``corners``, in metres, with points about ``spacing`` apart.

    A Catmull-Rom spline (A Class of Local Interpolating Splines, 1974), whose end pieces take the corner beyond the end
    in line with the last two.

    Raises:
        AssetError: there are fewer than two corners, or two that follow each other are the same.
    """
    given = np.asarray(corners, dtype=np.float64).reshape(-1, 3)
    if len(given) < 2 or (np.linalg.norm(np.diff(given, axis=0), axis=1) == 0.0).any():
        raise AssetError(
            "a rod is bent through two corners or more, of which no two that follow each other are the same"
        )
    # A spline of this kind needs a corner before the first and one after the last.
    ends = 2.0 * given[0] - given[1], 2.0 * given[-1] - given[-2]
    padded = np.concatenate((ends[:1], given, ends[1:]))
    u = np.linspace(0.0, 1.0, _FINE, endpoint=False)[:, None]
    pieces = [_piece(padded[index : index + 4], u) for index in range(len(given) - 1)]
    fine = np.concatenate((*pieces, given[-1:]))
    # Equal steps of the spline's parameter are no equal lengths: the points are placed by arc length.
    along = np.concatenate(([0.0], np.linalg.norm(np.diff(fine, axis=0), axis=1).cumsum()))
    places = np.linspace(0.0, along[-1], max(2, round(along[-1] / spacing) + 1))
    points = np.stack([np.interp(places, along, column) for column in fine.T], 1)
    ways = np.gradient(points, axis=0)
    return Course(points, ways / np.linalg.norm(ways, axis=1, keepdims=True), float(places[1]))


def bent_rod(name: str, course: Course, radius: float, every: int, pose: Pose) -> ObjectSpec:
    """Return a fixed rod along a course, with a capsule to every so many points, on two stands.

    The object's frame is the course's; its stands go down to the plane z = 0 of the frame that ``pose`` is in.
    """
    knots = course.points[np.unique(np.append(np.arange(0, len(course.points), every), len(course.points) - 1))]
    # Stands are capsules as well: every engine collides them exactly.
    feet = [(*end[:2], -pose.position[2]) for end in (knots[0], knots[-1])]
    lines = [*itertools.pairwise(knots), (knots[0], feet[0]), (knots[-1], feet[1])]
    shapes = tuple(_line(start, end, radius, _STEEL) for start, end in lines)
    articulation = Articulation(name, (solid_link(name, shapes, DENSITY),))
    return ObjectSpec(name=name, articulation=articulation, pose=pose, fixed_base=True, semantic_label="rod")


def ring_on_handle(name: str, radius: float, thickness: float, reach: float, pieces: int = 20) -> Articulation:
    """Return a ring in the xz plane, whose middle, the frame ``NAME_middle``, is ``reach`` along z from the handle's
    end.

    Args:
        name: of its one link.
        radius: metres from the middle to the ring's own middle line.
        thickness: metres, radius of its bars.
        reach: metres from the link's frame, where the handle ends, to the ring's middle.
        pieces: capsules around the ring.

    Raises:
        AssetError: the bars fill the ring, or the handle ends within it.
    """
    if not 0.0 < thickness < radius < reach:
        raise AssetError(
            f"ring '{name}' needs bars thinner than its radius and a handle that is longer, not {thickness:g} m, "
            f"{radius:g} m and {reach:g} m"
        )
    angles = 2.0 * math.pi * np.arange(pieces + 1) / pieces
    around = np.stack((radius * np.sin(angles), np.zeros_like(angles), reach - radius * np.cos(angles)), 1)
    lines = [*itertools.pairwise(around), (np.zeros(3), around[0])]
    shapes = tuple(_line(start, end, thickness, _BRASS) for start, end in lines)
    frame = Frame(f"{name}_middle", name, Pose((0.0, 0.0, reach)))
    return Articulation(name, (solid_link(name, shapes, DENSITY),), frames=(frame,))


def _piece(corners: npt.NDArray[np.float64], u: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
    """Return points between the second and the third of four corners."""
    a, b, c, d = corners
    return 0.5 * (2.0 * b + (c - a) * u + (2.0 * a - 5.0 * b + 4.0 * c - d) * u**2 + (3.0 * (b - c) + d - a) * u**3)


def _line(start: npt.ArrayLike, end: npt.ArrayLike, radius: float, color: Color) -> Shape:
    """Return a capsule from one point to another."""
    first, last = np.asarray(start, dtype=np.float64), np.asarray(end, dtype=np.float64)
    way = last - first
    length = float(np.linalg.norm(way))
    x, y, z = way / length
    across = math.hypot(x, y)
    # A vertical line has no turn about a horizontal axis: any axis serves.
    axis = (-y / across, x / across, 0.0) if across > 1e-9 else (1.0, 0.0, 0.0)
    px, py, pz = (0.5 * (first + last)).tolist()
    pose = Pose.from_axis_angle(axis, math.atan2(across, z), (px, py, pz))
    return Shape(Capsule(radius, 0.5 * length), pose, color=color)


Polygon = npt.NDArray[np.float64]
"""Corners (K, 2) in metres, counter-clockwise seen from above."""

BODY_HEIGHT = 0.05
"""Metres from a block's base to the top of its section."""
KNOB = 0.024
"""Metres, the edge of the square knob on top of a block, by which a gripper holds it; as high as it is wide."""
GRIP_HEIGHT = BODY_HEIGHT + 0.5 * KNOB
"""Metres from a block's base to the middle of its knob."""
BOARD_HEIGHT = 0.03
"""Metres of the board's thickness, through which its holes go."""
TILE = 0.09
"""Metres, the edge of the square of board around each hole."""
COLORS: Sequence[Color] = (
    (0.80, 0.20, 0.15, 1.0),
    (0.15, 0.35, 0.75, 1.0),
    (0.95, 0.70, 0.10, 1.0),
    (0.20, 0.60, 0.30, 1.0),
    (0.55, 0.30, 0.65, 1.0),
)
"""Colours of blocks that must look different."""
FIT = 0.001
"""Metres below which engines generate contacts between block and board."""
# Metres of board that a hole leaves at its tile's edge.
_LEAST_RIM = 0.01
# Sides of the polygon around a round hole: the corners are within 1 % of the circle.
_ROUND_SIDES = 24


@dataclass(frozen=True, eq=False)
class Section:
    """Cross-section of a block, seen from above.

    ``turns`` equal turns bring it onto itself; 0 means any turn, of a round section with that ``radius``.
    """

    outline: Polygon
    """Corners (K, 2) in metres."""
    turns: int
    radius: float = 0.0

    @property
    def turn(self) -> float:
        """rad of the least turn that brings it onto itself; zero where any does."""
        return 2.0 * math.pi / self.turns if self.turns else 0.0

    @property
    def width(self) -> float:
        """Metres along x."""
        return 2.0 * self.radius or float(np.ptp(self.outline[:, 0]))


def _regular(corners: int, *radii: float) -> Polygon:
    """Return corners on circles about the origin, whose radii alternate."""
    angles = 2.0 * math.pi * np.arange(corners) / corners
    return np.stack((np.cos(angles), np.sin(angles)), 1) * np.resize(radii, corners)[:, None]


def _around(radius: float) -> Polygon:
    """Return the polygon whose sides touch the circle."""
    return _regular(_ROUND_SIDES, radius / math.cos(math.pi / _ROUND_SIDES))


_SQUARE = np.array(((-0.02, -0.02), (0.02, -0.02), (0.02, 0.02), (-0.02, 0.02)))
_CORNER = np.array(((-0.02, -0.02), (0.02, -0.02), (0.02, 0.0), (0.0, 0.0), (0.0, 0.02), (-0.02, 0.02)))

SECTIONS: Mapping[str, Section] = {
    "round": Section(_around(0.02), turns=0, radius=0.02),
    "square": Section(_SQUARE, turns=4),
    "hexagon": Section(_regular(6, 0.023), turns=6),
    "star": Section(_regular(10, 0.027, 0.013), turns=5),
    "l": Section(_CORNER + 0.01 / 3.0, turns=1),  # the origin is the centroid
}
"""Sections by name, each about its centroid."""


def section(name: str) -> Section:
    """Return the section of that name.

    Raises:
        UnknownNameError: there is none.
    """
    if name not in SECTIONS:
        raise UnknownNameError("section of a block", name, SECTIONS)
    return SECTIONS[name]


def block(name: str, kind: str, *, color: Color, material: PhysicsMaterial | None = None) -> ObjectSpec:
    """Build a block of the section ``kind`` with a knob on top; its frame is in the middle of its base, z upward.

    Raises:
        UnknownNameError: there is no such section.
    """
    own, surface = section(kind), material or PhysicsMaterial()
    if own.radius:
        middle = Pose((0.0, 0.0, 0.5 * BODY_HEIGHT))
        parts: list[tuple[Geometry, Pose]] = [(Cylinder(own.radius, 0.5 * BODY_HEIGHT), middle)]
    else:
        parts = [prism(piece, BODY_HEIGHT) for piece in _inside(own.outline)]
    # The knob is a cube: any gripper that opens 24 mm can hold any block.
    parts.append((Box((0.5 * KNOB, 0.5 * KNOB, 0.5 * KNOB)), Pose((0.0, 0.0, GRIP_HEIGHT))))
    shapes = tuple(Shape(geometry, pose, surface, color, contact_distance=FIT) for geometry, pose in parts)
    articulation = Articulation(name, (solid_link(name, shapes, DENSITY),))
    return ObjectSpec(name=name, articulation=articulation, semantic_label="block")


def board(
    name: str, kinds: Sequence[str], clearance: float, *, color: Color = WOOD, material: PhysicsMaterial | None = None
) -> ObjectSpec:
    """Build a static board with a hole for each of the sections ``kinds``, in a row along y.

    Its frame is in the middle of its underside. Frames ``hole_0``, ``hole_1``, ... are at the base of a block that is
    inserted all the way.

    Args:
        name: of the object in its scene.
        kinds: names of sections.
        clearance: metres by which each hole is wider than its block, half of it on either side.
        color: of the board.
        material: of the board; the default one if None.

    Raises:
        UnknownNameError: there is no such section.
        AssetError: there are no kinds, a block is as wide as its hole or wider, or a hole too wide for the board.
    """
    if not kinds:
        raise AssetError(f"board '{name}' has no holes: name at least one section of a block")
    surface = material or PhysicsMaterial()
    shapes: list[Shape] = []
    frames: list[Frame] = []
    for index, kind in enumerate(kinds):
        place = Pose((0.0, (index - 0.5 * (len(kinds) - 1)) * TILE, 0.0))
        frames.append(Frame(f"hole_{index}", name, place))
        for piece in _outside(_hole(kind, clearance)):
            geometry, pose = prism(piece, BOARD_HEIGHT)
            shapes.append(Shape(geometry, place @ pose, surface, color, contact_distance=FIT))
    articulation = Articulation(name, (solid_link(name, shapes, DENSITY),), frames=tuple(frames))
    return ObjectSpec(name=name, articulation=articulation, fixed_base=True, semantic_label="board")


def _hole(kind: str, clearance: float) -> Polygon:
    own = section(kind)
    width = 1000.0 * own.width
    if not clearance > 0.0:
        raise AssetError(
            f"the block '{kind}' is {width:g} mm wide and its hole {width + 1000.0 * clearance:g} mm, so that it does "
            "not go in: give a clearance above zero"
        )
    hole = _widened(own.outline, 0.5 * clearance)
    if np.abs(hole).max() > 0.5 * TILE - _LEAST_RIM:
        raise AssetError(
            f"the hole of the block '{kind}', {width:g} mm wide, with a clearance of {1000.0 * clearance:g} mm breaks "
            f"through its tile of {1000.0 * TILE:g} mm: give a smaller clearance"
        )
    return hole


def _widened(outline: Polygon, margin: float) -> Polygon:
    """Return the polygon whose sides are ``margin`` metres further out."""
    sides = np.roll(outline, -1, axis=0) - outline
    normals = np.stack((sides[:, 1], -sides[:, 0]), 1) / np.linalg.norm(sides, axis=1, keepdims=True)
    offsets = (normals * outline).sum(1) + margin
    # Each new corner is on the two shifted sides that meet there: two linear equations.
    rows = np.stack((np.roll(normals, 1, axis=0), normals), 1)
    return np.linalg.solve(rows, np.stack((np.roll(offsets, 1), offsets), 1)[..., None])[..., 0]


def _inside(outline: Polygon) -> list[Polygon]:
    """Return convex parts of a section: itself, rectangles, or a kite about each of a star's tips."""
    sides = np.roll(outline, -1, axis=0) - outline
    bends = _cross(np.roll(sides, 1, axis=0), sides)
    if (bends > 0.0).all():
        return [outline]
    if _rectilinear(outline):
        return [piece for piece, inside in _rectangles(outline) if inside]
    # A left turn is a convex corner of a counter-clockwise outline: the tip of a star's ray.
    tips = np.flatnonzero(bends > 0.0)
    return [np.stack((np.zeros(2), outline[tip - 1], outline[tip], outline[(tip + 1) % len(outline)])) for tip in tips]


def _outside(hole: Polygon) -> list[Polygon]:
    """Return convex parts of the tile around a star-shaped hole: one per side, or rectangles."""
    if _rectilinear(hole):
        return [piece for piece, inside in _rectangles(hole) if not inside]
    pieces = []
    for first, second in zip(hole, np.roll(hole, -1, axis=0), strict=True):
        piece = _tile()
        for along, through in ((first, np.zeros(2)), (-second, np.zeros(2)), (first - second, first)):
            piece = _left_of(piece, along, through)
        pieces.append(piece)
    return pieces


def _rectangles(outline: Polygon) -> list[tuple[Polygon, bool]]:
    """Cut the tile along x at every corner, and each strip at the sides that cross it; True for parts inside."""
    half = 0.5 * TILE
    # Rounded, for corners at one height may differ in the last bit.
    levels = (-half, *np.unique(outline[:, 1].round(9)), half)
    starts, ends = outline, np.roll(outline, -1, axis=0)
    found = []
    for low, high in itertools.pairwise(levels):
        middle = 0.5 * (low + high)
        crossing = (np.minimum(starts[:, 1], ends[:, 1]) < middle) & (middle < np.maximum(starts[:, 1], ends[:, 1]))
        cuts = (-half, *np.sort(starts[crossing, 0]), half)
        for number, (left, right) in enumerate(itertools.pairwise(cuts)):
            found.append((np.array(((left, low), (right, low), (right, high), (left, high))), number % 2 == 1))
    return found


def prism(polygon: Polygon, height: float) -> tuple[Geometry, Pose]:
    """Return the solid of a height (m) above a convex polygon, and the pose of its frame."""
    low, high = polygon.min(0), polygon.max(0)
    if len(polygon) == 4 and _rectilinear(polygon):
        x, y = 0.5 * (low + high)
        return Box((*(0.5 * (high - low)).tolist(), 0.5 * height)), Pose((float(x), float(y), 0.5 * height))
    count = len(polygon)
    # Vertices of the lower face, then of the upper one, in the polygon's order.
    vertices = np.concatenate([np.c_[polygon, np.full(count, z)] for z in (-0.5 * height, 0.5 * height)])
    faces = [(0, k + 1, k) for k in range(1, count - 1)] + [
        (count, count + k, count + k + 1) for k in range(1, count - 1)
    ]
    for k in range(count):
        after = (k + 1) % count
        faces += [(k, after, count + after), (k, count + after, count + k)]
    return Mesh(vertices, np.array(faces)), Pose((0.0, 0.0, 0.5 * height))


def _tile() -> Polygon:
    return _regular(4, TILE / math.sqrt(2.0)) @ np.array(((1.0, 1.0), (-1.0, 1.0))) / math.sqrt(2.0)


def _left_of(polygon: Polygon, along: Polygon, through: Polygon) -> Polygon:
    """Return the part of a convex polygon on the left of a line, by Sutherland and Hodgman's clipping (1974)."""
    heights = _cross(along, polygon - through)
    kept: list[Polygon] = []
    # Corners on the left stay; where a side crosses the line, its crossing is added.
    for k, (corner, height) in enumerate(zip(polygon, heights, strict=True)):
        before, below = polygon[k - 1], heights[k - 1]
        if (height > 0.0) != (below > 0.0):
            kept.append(before + (corner - before) * (below / (below - height)))
        if height > 0.0:
            kept.append(corner)
    return np.array(kept)


def _rectilinear(outline: Polygon) -> bool:
    sides = np.roll(outline, -1, axis=0) - outline
    return bool(np.isclose(sides, 0.0, atol=1e-12).any(1).all())


def _cross(first: Polygon, second: Polygon) -> Polygon:
    return first[..., 0] * second[..., 1] - first[..., 1] * second[..., 0]
