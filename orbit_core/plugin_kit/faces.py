"""Flat faces of a surface of triangles: neighbours in one plane, joined to convex polygons.

An engine that meets the triangles of a level floor one by one feels the edges between them, which are not there.
"""

from __future__ import annotations

import heapq
import math
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
_SAME_PLANE, _FLAT = 1e-4, 1e-5
"""Largest sine of the angle between neighbours in one plane, which vertices in single precision keep within, and
largest share of a patch's width by which its corners leave their plane."""
_FULL = 1e-6
"""Share of its convex hull's area that two faces may lack to be taken for a convex one."""


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

    A face so grows along a row of cells to its end, then rows of one length join: what is left of edges lies between
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
