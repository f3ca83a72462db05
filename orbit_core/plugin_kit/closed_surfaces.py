"""Closed surfaces: what is inside of them, and whether they are convex."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

FloatArray = npt.NDArray[np.float64]
_CONVEX = 2e-3
"""Part of the extent by which a vertex may be in front of a face of a surface that is taken for convex."""
_OFF_EDGES = np.array([1.3e-5, 0.7e-5])
"""Part of the extent by which lines are moved, so that they miss edges and vertices of regular meshes."""


def inside_lattice(
    axes: Sequence[FloatArray], vertices: npt.NDArray[np.floating], faces: npt.NDArray[np.integer]
) -> npt.NDArray[np.bool_]:
    """Return which points of a lattice are inside, (X, Y, Z); arguments are those of :func:`winding_numbers`."""
    return winding_numbers(axes, vertices, faces) > 0


def winding_numbers(
    axes: Sequence[FloatArray], vertices: npt.NDArray[np.floating], faces: npt.NDArray[np.integer]
) -> npt.NDArray[np.int64]:
    """Return how often a surface encloses the points of a lattice, (X, Y, Z).

    Along a line of points it is the sum of the crossings above, signed by how triangles face.

    Args:
        axes: coordinates of the lattice along x, y and z, m.
        vertices: (V, 3) of the surface, m.
        faces: (F, 3), counter-clockwise as seen from outside.
    """
    off = _OFF_EDGES * np.ptp(vertices, axis=0)[:2]
    # Triangles that are seen edge-on cover no line of points.
    found = np.zeros([len(axis) for axis in axes], dtype=np.int64)
    flat = vertices[faces][..., :2]
    a, ab, ac = flat[:, 0], flat[:, 1] - flat[:, 0], flat[:, 2] - flat[:, 0]
    area = ab[:, 0] * ac[:, 1] - ab[:, 1] * ac[:, 0]
    facing = np.abs(area) > 1e-12 * np.prod(np.ptp(vertices, axis=0)[:2])
    a, ab, ac, area, heights = a[facing], ab[facing], ac[facing], area[facing], vertices[faces][facing][..., 2]
    for i, x in enumerate(axes[0] + off[0]):
        for j, y in enumerate(axes[1] + off[1]):
            at = np.array([x, y]) - a
            u = (at[:, 0] * ac[:, 1] - at[:, 1] * ac[:, 0]) / area
            v = (ab[:, 0] * at[:, 1] - ab[:, 1] * at[:, 0]) / area
            hit = (u >= 0.0) & (v >= 0.0) & (u + v <= 1.0)
            z = heights[hit, 0] * (1.0 - u[hit] - v[hit]) + heights[hit, 1] * u[hit] + heights[hit, 2] * v[hit]
            found[i, j] = (np.sign(area[hit])[:, None] * (z[:, None] > axes[2])).sum(axis=0)
    return found


def is_convex(vertices: npt.NDArray[np.floating], faces: npt.NDArray[np.integer]) -> bool:
    """Return True if no vertex (V, 3) is in front of a face (F, 3), so that a solid cannot touch itself."""
    a, b, c = (vertices[faces[:, k]] for k in range(3))
    normals = np.cross(b - a, c - a)
    # A triangle without area has no normal, and nothing is in front of it.
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-300)
    ahead = normals @ vertices.T - (normals * a).sum(axis=1, keepdims=True)
    return bool(ahead.max() < _CONVEX * np.ptp(vertices, axis=0).max())
