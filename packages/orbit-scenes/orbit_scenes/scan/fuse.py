"""Surface of a field of truncated signed distances, by surface nets.

Gibson, Constrained elastic surface nets: Generating smooth surfaces from binary segmented data (MICCAI 1998): a vertex
in every cube that the surface passes, at the mean of the points where it crosses the cube's edges.
"""

from __future__ import annotations

import itertools
from typing import Any

import numpy as np
import numpy.typing as npt

from orbit_core.interfaces.errors import ArgumentError
from orbit_core.scene import Mesh, MeshCollision
from orbit_core.scene.pose import FloatArray

_CORNERS = tuple(itertools.product((0, 1), repeat=3))
# Edges of a cube: pairs of corners that differ in one coordinate.
_EDGES = tuple(
    (a, b) for a, b in itertools.combinations(range(8), 2) if sum(np.abs(np.subtract(_CORNERS[a], _CORNERS[b]))) == 1
)


def extract_surface(distances: npt.ArrayLike, weights: npt.ArrayLike, lower: npt.ArrayLike, voxel_size: float) -> Mesh:
    """Return the surface where a field is zero, facing the positive side.

    Cubes with a voxel that was never seen have no surface: there the field jumps from free to unknown.

    Args:
        distances: (X, Y, Z) in m at the voxels' centres, positive in free space.
        weights: (X, Y, Z), zero where a voxel was not seen.
        lower: (3,) corner of least coordinates of the first voxel, m.
        voxel_size: of a voxel's edge, m.

    Raises:
        ArgumentError: the arrays differ in shape, or the field has no surface.
    """
    field, seen = np.asarray(distances, dtype=np.float64), np.asarray(weights) > 0.0
    if field.ndim != 3 or field.shape != seen.shape or min(field.shape) < 2:
        raise ArgumentError(f"a field has distances {field.shape} and weights {seen.shape}: give (X, Y, Z) each")
    values = np.stack([_shifted(field, corner) for corner in _CORNERS])
    known = np.logical_and.reduce([_shifted(seen, corner) for corner in _CORNERS])
    inside = values < 0.0
    crossed = known & inside.any(0) & ~inside.all(0)
    if not crossed.any():
        raise ArgumentError("the field has no surface: no voxel that was seen is behind one")
    number = np.full(crossed.shape, -1, dtype=np.int64)
    number[crossed] = np.arange(int(crossed.sum()))
    # Voxels' values belong to their centres, half a voxel from their corners.
    cells = np.argwhere(crossed)
    places = np.asarray(lower, dtype=np.float64) + (cells + 0.5 + _offsets(values[:, crossed])) * voxel_size
    faces = _quads(field, number)
    return Mesh(places.astype(np.float32), faces.astype(np.int32), MeshCollision.TRIANGLES)


def _shifted(array: npt.NDArray[Any], corner: tuple[int, ...]) -> npt.NDArray[Any]:
    """Return the values of one corner of every cube."""
    x, y, z = corner
    return array[x : array.shape[0] - 1 + x, y : array.shape[1] - 1 + y, z : array.shape[2] - 1 + z]


def _offsets(values: FloatArray) -> FloatArray:
    """Return the mean crossing (C, 3) of the edges of cubes with corner values (8, C), in units of a cube."""
    total, count = np.zeros((values.shape[1], 3)), np.zeros(values.shape[1])
    for a, b in _EDGES:
        first, second = values[a], values[b]
        cross = (first < 0.0) != (second < 0.0)
        # Linear between the two corners; edges that do not cross count for nothing.
        share = np.where(cross, first / np.where(cross, first - second, 1.0), 0.0)
        start, way = np.array(_CORNERS[a]), np.subtract(_CORNERS[b], _CORNERS[a])
        total += np.where(cross[:, None], start + share[:, None] * way, 0.0)
        count += cross
    return total / count[:, None]


def _quads(field: FloatArray, number: npt.NDArray[np.int64]) -> npt.NDArray[np.int64]:
    """Return triangles (F, 3) across every voxel edge that the surface crosses, where all four cubes around it do."""
    found = []
    for axis in range(3):
        u, v = (axis + 1) % 3, (axis + 2) % 3
        inside = field < 0.0
        low = np.moveaxis(inside, (axis, u, v), (0, 1, 2))
        cubes = np.moveaxis(number, (axis, u, v), (0, 1, 2))
        # The edge from (i, j, k) to (i + 1, j, k) is shared by the cubes (i, j - 1 .. j, k - 1 .. k).
        flips = low[:-1, 1:-1, 1:-1] != low[1:, 1:-1, 1:-1]
        around = np.stack((cubes[:, :-1, :-1], cubes[:, 1:, :-1], cubes[:, 1:, 1:], cubes[:, :-1, 1:]), axis=-1)
        quads = around[flips]
        turned = low[:-1, 1:-1, 1:-1][flips]
        whole = (quads >= 0).all(1)
        quads, turned = quads[whole], turned[whole]
        # Counter-clockwise seen from free space: solid first along the axis means facing up it.
        quads = np.where(turned[:, None], quads, quads[:, ::-1])
        found += [quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]]
    return np.concatenate(found)
