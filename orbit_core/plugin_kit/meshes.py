"""Shapes and markers as triangles, and flat faces of triangle surfaces as convex polygons."""

from __future__ import annotations

import functools
import heapq
import math
from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from orbit_core.interfaces.errors import ConfigurationError
from orbit_core.scene import (
    Box,
    Capsule,
    Color,
    Cylinder,
    Geometry,
    HeightField,
    MarkerShape,
    MarkerSpec,
    Mesh,
    Plane,
    Pose,
    Shape,
    Sphere,
)

if TYPE_CHECKING:
    from trimesh import Trimesh

CREASE_ANGLE = math.radians(30.0)
"""Edges sharper than this are drawn sharp."""
FloatArray = npt.NDArray[np.float64]
# Most planes of a height field that is made of its faces, and digits of slopes and metres that distinguish planes
_FEW, _DIGITS = 8, 5
Point = tuple[float, float]
Polygon = list[Point]
IntArray = npt.NDArray[np.int64]
# Largest sine of the angle between neighbours in one plane, which vertices in single precision keep within, and largest
# share of a patch's width by which its corners leave their plane
_SAME_PLANE, _FLAT = 1e-4, 1e-5
# Share of its convex hull's area that two faces may lack to be taken for a convex one
_FULL = 1e-6
AXIS_COLORS = ((0.9, 0.2, 0.2), (0.2, 0.8, 0.25), (0.2, 0.4, 0.95))
"""Red, green and blue (sRGB, 0 to 1) of the axes x, y and z of a frame."""


def height_field_mesh(field: HeightField) -> tuple[npt.NDArray[np.float64], npt.NDArray[np.int64]]:
    """Return vertices (V, 3) and faces (F, 3), two a cell, whose normals point up."""
    heights = np.asarray(field.heights, np.float64)
    rows, columns = heights.shape
    x = np.linspace(-field.size[0] / 2, field.size[0] / 2, columns)
    y = np.linspace(-field.size[1] / 2, field.size[1] / 2, rows)
    vertices = np.stack((*np.meshgrid(x, y), heights), -1).reshape(-1, 3)
    corner = (np.arange(rows - 1)[:, None] * columns + np.arange(columns - 1)).ravel()
    right, above, across = corner + 1, corner + columns, corner + columns + 1
    faces = np.concatenate((np.stack((corner, right, across), -1), np.stack((corner, across, above), -1)))
    return vertices, faces


def triangles(geometry: Geometry) -> Trimesh:
    """Return the surface of a geometry in its own frame, with vertices doubled along sharp edges.

    Raises:
        ConfigurationError: a plane has no end.
    """
    import trimesh

    match geometry:
        case Box(half_extents=half):
            mesh = trimesh.creation.box(extents=2.0 * np.asarray(half))
        case Sphere(radius=radius):
            return trimesh.creation.uv_sphere(radius, count=(24, 32))
        case Capsule(radius=radius, half_length=half):
            mesh = trimesh.creation.capsule(height=2.0 * half, radius=radius, count=(24, 32))
            # trimesh puts the lower end of a capsule at the origin.
            mesh.apply_translation((0.0, 0.0, -mesh.bounds.mean(axis=0)[2]))
            return mesh
        case Cylinder(radius=radius, half_length=half):
            mesh = trimesh.creation.cylinder(radius, height=2.0 * half, sections=40)
        case Mesh(vertices=vertices, faces=faces):
            mesh = trimesh.Trimesh(vertices, faces, process=False)
        case HeightField():
            return trimesh.Trimesh(*height_field_mesh(geometry), process=False)
        case Plane():
            raise ConfigurationError("a plane has no end and cannot be made of triangles: draw it as a grid")
    return trimesh.graph.smooth_shade(mesh, angle=CREASE_ANGLE)


@functools.lru_cache(maxsize=32)
def hull_of(mesh: Mesh) -> Mesh:
    """Return the convex hull of a mesh, which need not be convex where its collision is ``CONVEX_HULL``."""
    import trimesh

    hull = trimesh.Trimesh(mesh.vertices, mesh.faces, process=False).convex_hull
    return Mesh(np.asarray(hull.vertices), np.asarray(hull.faces))


def convex_faces(vertices: npt.NDArray[np.floating], triangles: npt.NDArray[np.integer]) -> list[FloatArray]:
    """Return convex polygons, each (corners, 3), that cover the same surface.

    Args:
        vertices: (V, 3) in metres; vertices in one place count as one.
        triangles: (T, 3) numbers of vertices, counter-clockwise seen from outside, as the polygons' corners are.
            Triangles without an area are left out.
    """
    corners = np.asarray(vertices, np.float64)[triangles]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    areas = np.linalg.norm(normals, axis=-1)
    whole = areas > 0.0
    corners, normals = corners[whole], normals[whole] / areas[whole, None]
    places = np.unique(corners.reshape(-1, 3), axis=0, return_inverse=True)[1].reshape(-1, 3)
    pairs = _neighbours(places)
    flat = np.linalg.norm(np.cross(normals[pairs[:, 0]], normals[pairs[:, 1]]), axis=-1) < _SAME_PLANE
    flat &= (normals[pairs[:, 0]] * normals[pairs[:, 1]]).sum(-1) > 0.0
    found: list[FloatArray] = []
    for members in _patches(len(corners), pairs[flat]):
        single = len(members) == 1
        found += [corners[members[0]]] if single else _join(corners[members], places[members], normals[members].mean(0))
    return found


def few_faces(field: HeightField) -> list[FloatArray] | None:
    """Return the convex faces of a height field that has a few planes in all; None for any other."""
    vertices, triangles = height_field_mesh(field)
    corners = vertices[triangles]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    # Triangles of a height field are never upright, so that this does not divide by zero.
    slopes = -normals[:, :2] / normals[:, 2:]
    planes = np.column_stack((slopes, corners[:, 0, 2] - (slopes * corners[:, 0, :2]).sum(-1)))
    planes = planes.round(_DIGITS)
    if any(len(np.unique(column)) > _FEW for column in planes.T):  # an eighth of the time of whole rows
        return None
    return convex_faces(vertices, triangles) if len(np.unique(planes, axis=0)) <= _FEW else None


def fans(faces: Sequence[FloatArray]) -> tuple[FloatArray, IntArray]:
    """Return vertices (V, 3) and triangles (T, 3) of convex faces, each a fan around its first corner."""
    starts = np.cumsum([0, *map(len, faces)])
    triangles = [
        (start, start + k, start + k + 1)
        for start, face in zip(starts[:-1], faces, strict=True)
        for k in range(1, len(face) - 1)
    ]
    return np.concatenate((np.zeros((0, 3)), *faces)), np.array(triangles, np.int64).reshape(-1, 3)


def _neighbours(places: IntArray) -> IntArray:
    """Return the pairs (P, 2) of triangles (T, 3) that share an edge, where no third has it."""
    edges = np.sort(places[:, ((0, 1), (1, 2), (2, 0))].reshape(-1, 2), axis=-1)
    _, number, count = np.unique(edges, axis=0, return_inverse=True, return_counts=True)
    order = np.argsort(number.ravel(), kind="stable")
    shared = order[count[number.ravel()[order]] == 2]
    return shared.reshape(-1, 2) // 3


def _patches(count: int, pairs: IntArray) -> list[IntArray]:
    """Return the triangles of each connected patch, given the neighbours (P, 2) in one plane."""
    root = np.arange(count)
    while True:  # labels spread to neighbours, and along chains of them in doubling steps
        least = np.minimum(root[pairs[:, 0]], root[pairs[:, 1]])
        spread = root.copy()
        for side in pairs.T:
            np.minimum.at(spread, root[side], least)
        spread = spread[spread]
        if np.array_equal(spread, root):
            break
        root = spread
    order = np.argsort(root, kind="stable")
    return np.split(order, np.flatnonzero(np.diff(root[order])) + 1)


def _join(corners: FloatArray, places: IntArray, normal: FloatArray) -> list[FloatArray]:
    """Return the convex polygons that a greedy search finds for a flat patch.

    Args:
        corners: (T, 3, 3) of its triangles.
        places: (T, 3) numbers of the corners, equal where corners are in one place.
        normal: (3,) of any length.
    """
    normal = normal / np.linalg.norm(normal)
    across = np.cross(normal, np.eye(3)[np.abs(normal).argmin()])
    across /= np.linalg.norm(across)
    axes = np.stack((across, np.cross(normal, across)))
    flat = (corners - corners[0, 0]) @ axes.T
    heights = (corners - corners[0, 0]) @ normal
    if np.ptp(heights) > _FLAT * np.ptp(flat.reshape(-1, 2), axis=0).max():  # bent by little at each of many edges
        return list(corners)
    lift = corners[0, 0] + heights.mean() * normal
    point_of = dict(zip(places.ravel().tolist(), map(tuple, flat.reshape(-1, 2).tolist()), strict=True))
    triangles: list[Polygon] = [[point_of[place] for place in triangle] for triangle in places.tolist()]
    whole = _hull(list(point_of.values()))
    convex = _area(whole) <= sum(map(_area, triangles)) * (1.0 + _FULL)
    return [lift + np.array(polygon) @ axes for polygon in ([whole] if convex else _grow(triangles))]


def _grow(polygons: list[Polygon]) -> list[Polygon]:
    """Join neighbours whose union is convex, the largest first.

    A face so grows along a row of cells to its end, then rows of one length join: the remaining edges are between
    rectangles as wide as the patch, and seldom in the midst of it. The union of two convex polygons is convex only if
    they share one side from end to end.
    """
    owner = {side: number for number, polygon in enumerate(polygons) for side in _sides(polygon)}
    areas, joined = list(map(_area, polygons)), set[int]()
    queue: list[tuple[float, float, int, int, Polygon]] = []

    def offer(one: int) -> None:
        for a, b in _sides(polygons[one]):
            other = owner.get((b, a))
            if other is None:
                continue
            hull, area = _hull(polygons[one] + polygons[other]), areas[one] + areas[other]
            if _area(hull) <= area * (1.0 + _FULL):
                heapq.heappush(queue, (-area, -math.dist(a, b), one, other, hull))

    for number in range(len(polygons)):
        offer(number)
    while queue:
        *_, one, other, hull = heapq.heappop(queue)
        if one in joined or other in joined:
            continue
        joined |= {one, other}
        for gone in (one, other):
            for side in _sides(polygons[gone]):
                owner.pop(side, None)
        owner |= dict.fromkeys(_sides(hull), len(polygons))
        polygons.append(hull)
        areas.append(_area(hull))
        offer(len(polygons) - 1)
    return [polygon for number, polygon in enumerate(polygons) if number not in joined]


def _sides(polygon: Polygon) -> Iterator[tuple[Point, Point]]:
    return zip(polygon, polygon[1:] + polygon[:1], strict=True)


def _hull(points: Polygon) -> Polygon:
    """Return the corners of the convex hull, counter-clockwise, without those along its edges."""
    ordered = sorted(set(points))
    slack = _FULL * ((ordered[-1][0] - ordered[0][0]) ** 2 + max(abs(a[1] - ordered[0][1]) for a in ordered) ** 2)

    def chain(ordered: Polygon) -> Polygon:
        kept: Polygon = []
        for point in ordered:
            while len(kept) > 1 and _turn(kept[-2], kept[-1], point) <= slack:
                kept.pop()
            kept.append(point)
        return kept[:-1]

    return chain(ordered) + chain(ordered[::-1])


def _turn(a: Point, b: Point, c: Point) -> float:
    return (b[0] - a[0]) * (c[1] - b[1]) - (b[1] - a[1]) * (c[0] - b[0])


def _area(polygon: Polygon) -> float:
    x, y = polygon[0]
    return 0.5 * abs(sum((a[0] - x) * (b[1] - y) - (b[0] - x) * (a[1] - y) for a, b in _sides(polygon)))


def marker_shapes(marker: MarkerSpec) -> tuple[Shape, ...]:
    """Return a marker as shapes: an arrow along x, or a frame with x, y, z in red, green, blue, and its own."""
    return (*marker.shapes, *_sign(marker)) if marker.size > 0.0 else marker.shapes


def _sign(marker: MarkerSpec) -> tuple[Shape, ...]:
    size = marker.size
    match marker.shape:
        case MarkerShape.SPHERE:
            return (Shape(Sphere(size / 2), color=marker.color),)
        case MarkerShape.BOX:
            return (Shape(Box((size / 2, size / 2, size / 2)), color=marker.color),)
        case MarkerShape.ARROW:
            return _arrow(size, size / 25, Pose.from_euler(0.0, math.pi / 2, 0.0), marker.color)
        case MarkerShape.FRAME:
            opacity = marker.color[3]
            turns = ((0.0, math.pi / 2, 0.0), (-math.pi / 2, 0.0, 0.0), (0.0, 0.0, 0.0))
            return tuple(
                shape
                for turn, (r, g, b) in zip(turns, AXIS_COLORS, strict=True)
                for shape in _arrow(size, size / 30, Pose.from_euler(*turn), (r, g, b, opacity))
            )


def _arrow(length: float, radius: float, pose: Pose, color: Color) -> tuple[Shape, Shape]:
    """Return shaft and tip of an arrow along z of ``pose``, from its origin."""
    shaft = Cylinder(radius, 0.375 * length)
    return (
        Shape(shaft, pose @ Pose((0.0, 0.0, 0.375 * length)), color=color),
        Shape(_cone(2.5 * radius, 0.25 * length), pose @ Pose((0.0, 0.0, 0.75 * length)), color=color),
    )


def _cone(radius: float, height: float) -> Mesh:
    import trimesh

    cone = trimesh.creation.cone(radius, height, sections=24)
    return Mesh(np.asarray(cone.vertices), np.asarray(cone.faces))
