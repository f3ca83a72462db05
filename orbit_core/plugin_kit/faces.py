"""Flat faces of a surface of triangles: neighbours in one plane, joined to convex polygons.

An engine that meets the triangles of a level floor one by one feels the edges between them, which are not there.
"""

from __future__ import annotations

import heapq
import math
from collections import defaultdict
from collections.abc import Iterator, Sequence

import numpy as np
import numpy.typing as npt

from orbit_core.plugin_kit.meshes import height_field_mesh
from orbit_core.scene import HeightField

FloatArray = npt.NDArray[np.float64]
_FEW, _DIGITS = 8, 5
"""Most planes of a height field that is made of its faces, and digits of slopes and metres that tell planes apart."""
Point = tuple[float, float]
Polygon = list[Point]
IntArray = npt.NDArray[np.int64]
_SAME_PLANE = 1e-6
"""Largest sine of the angle between neighbours in one plane; vertices in single precision keep within it."""
_FULL = 1e-6
"""Share of its convex hull's area that two faces may lack to be taken for a convex one."""


def convex_faces(vertices: FloatArray, triangles: IntArray) -> list[FloatArray]:
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
    for members, edges in _patches(len(corners), pairs[flat]):
        if len(members) == 1:
            found.append(corners[members[0]])
        else:
            found += _join(corners[members], normals[members].mean(0), edges)
    return found


def few_faces(field: HeightField) -> list[FloatArray] | None:
    """Return the convex faces of a height field that has a few planes in all; None for any other."""
    vertices, triangles = height_field_mesh(field)
    corners = vertices[triangles]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    slopes = -normals[:, :2] / normals[:, 2:]
    planes = np.column_stack((slopes, corners[:, 0, 2] - (slopes * corners[:, 0, :2]).sum(-1)))
    few = len(np.unique(planes.round(_DIGITS), axis=0)) <= _FEW
    return convex_faces(vertices, triangles) if few else None


def fans(faces: Sequence[FloatArray]) -> tuple[FloatArray, IntArray]:
    """Return vertices (V, 3) and triangles (T, 3) of convex faces, each a fan around its first corner."""
    starts = np.cumsum([0, *map(len, faces)])
    triangles = [
        (start, start + k, start + k + 1) for start, face in zip(starts[:-1], faces, strict=True) for k in range(1, len(face) - 1)
    ]
    return np.concatenate((np.zeros((0, 3)), *faces)), np.array(triangles, np.int64).reshape(-1, 3)


def _neighbours(places: IntArray) -> IntArray:
    """Return the pairs (P, 2) of triangles (T, 3) that share an edge, where no third has it."""
    edges = np.sort(places[:, ((0, 1), (1, 2), (2, 0))].reshape(-1, 2), axis=-1)
    _, number, count = np.unique(edges, axis=0, return_inverse=True, return_counts=True)
    order = np.argsort(number.ravel(), kind="stable")
    shared = order[count[number.ravel()[order]] == 2]
    return shared.reshape(-1, 2) // 3


def _patches(count: int, pairs: IntArray) -> Iterator[tuple[IntArray, IntArray]]:
    """Yield the triangles of each connected patch, and its pairs by their places among these."""
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
    starts = np.flatnonzero(np.diff(root[order], prepend=-1))
    place = np.empty(count, np.int64)
    place[order] = np.arange(count)
    by_patch = pairs[np.argsort(root[pairs[:, 0]], kind="stable")]
    owners = root[by_patch[:, 0]]
    for start, end in zip(starts, (*starts[1:], count), strict=True):
        own = slice(*np.searchsorted(owners, (root[order[start]], root[order[start]] + 1)))
        yield order[start:end], place[by_patch[own]] - start


def _join(corners: FloatArray, normal: FloatArray, edges: IntArray) -> list[FloatArray]:
    """Return the fewest convex polygons that a greedy search finds for a flat patch of triangles (T, 3, 3)."""
    normal = normal / np.linalg.norm(normal)
    across = np.cross(normal, np.eye(3)[np.abs(normal).argmin()])
    across /= np.linalg.norm(across)
    axes = np.stack((across, np.cross(normal, across)))
    flat = (corners - corners[0, 0]) @ axes.T
    lift = corners[0, 0] + ((corners - corners[0, 0]) @ normal).mean() * normal
    triangles = [[(x, y) for x, y in triangle] for triangle in flat.tolist()]
    whole = _hull([point for triangle in triangles for point in triangle])
    one = _area(whole) <= sum(map(_area, triangles)) * (1.0 + _FULL)
    return [lift + np.array(polygon) @ axes for polygon in ([whole] if one else _grow(triangles, edges))]


def _grow(polygons: list[Polygon], edges: IntArray) -> list[Polygon]:
    """Join neighbours whose union is convex, first those that share most of their outlines."""
    neighbours: dict[int, set[int]] = defaultdict(set)
    areas, outlines = list(map(_area, polygons)), list(map(_outline, polygons))
    queue: list[tuple[float, int, int, Polygon]] = []

    def offer(one: int, other: int) -> None:
        neighbours[one].add(other)
        neighbours[other].add(one)
        hull = _hull(polygons[one] + polygons[other])
        if _area(hull) <= (areas[one] + areas[other]) * (1.0 + _FULL):
            heapq.heappush(queue, (_outline(hull) - outlines[one] - outlines[other], one, other, hull))

    for one, other in edges.tolist():
        offer(one, other)
    joined: set[int] = set()
    while queue:
        _, one, other, hull = heapq.heappop(queue)
        if one in joined or other in joined:
            continue
        joined |= {one, other}
        around = neighbours.pop(one) | neighbours.pop(other)
        polygons.append(hull)
        areas.append(_area(hull))
        outlines.append(_outline(hull))
        for near in sorted(around - {one, other}):
            neighbours[near] -= {one, other}
            offer(near, len(polygons) - 1)
    return [polygon for number, polygon in enumerate(polygons) if number not in joined]


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
    (x, y) = polygon[0]
    sides = zip(polygon, polygon[1:] + polygon[:1], strict=True)
    return 0.5 * abs(sum((a[0] - x) * (b[1] - y) - (b[0] - x) * (a[1] - y) for a, b in sides))


def _outline(polygon: Polygon) -> float:
    return sum(math.dist(a, b) for a, b in zip(polygon, polygon[1:] + polygon[:1], strict=True))
