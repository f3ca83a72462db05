"""Points spread over a surface, for its contacts."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from orbit_matter.solids.element import FloatArray

_DENSER = 4.0
"""Times as many points as the spacing asks for, above which fine meshes are thinned out."""


@dataclass(frozen=True, eq=False)
class Skin:
    """Points of a surface, each with the area around it."""

    points: FloatArray
    """(P, 3) m."""
    areas: FloatArray
    """(P, 3, 3) m^2: sum of ``area n n^T`` of the faces around each, so that ``n^T areas n`` is what faces along n. The
    area that meets a plate at an edge is that of one side only."""


def sampled(vertices: FloatArray, faces: npt.NDArray[np.int64], spacing: float) -> Skin:
    """Return points about ``spacing`` metres from each other: vertices, and points between them where these are far.

    Edges are halved until none is longer than the diagonal of a square of that size. Of finer meshes one vertex of each
    cube of that size stays, with the area of the others.
    """
    points, triangles = vertices, faces
    # A little more than the diagonal, so that rounding divides no square once too often.
    longest = 1.01 * np.sqrt(2.0) * spacing
    while True:
        points, triangles, divided = _halved(points, triangles, longest)
        if not divided:
            break
    a, b, c = (points[triangles[:, corner]] for corner in range(3))
    across = np.cross(b - a, c - a)
    twice = np.linalg.norm(across, axis=1)[:, None, None]
    shares = across[:, :, None] * across[:, None, :] / (6.0 * np.maximum(twice, 1e-300))
    areas = np.zeros((len(points), 3, 3))
    # A third of each triangle to each of its corners integrates what is linear over it exactly.
    for corner in range(3):
        np.add.at(areas, triangles[:, corner], shares)
    if len(points) > _DENSER * np.einsum("pii->", areas) / spacing**2:
        points, areas = _thinned(points, areas, spacing)
    return Skin(points, areas)


def _halved(
    points: FloatArray, triangles: npt.NDArray[np.int64], longest: float
) -> tuple[FloatArray, npt.NDArray[np.int64], bool]:
    """Divide each triangle that has an edge that is too long at its longest edge, together with the one across it.

    Longest edges are halved in both triangles that share them, so that no vertex is on another triangle's edge.
    """
    pairs = np.sort(np.stack((triangles, np.roll(triangles, -1, axis=1)), -1), axis=-1)
    lengths = np.linalg.norm(points[pairs[..., 0]] - points[pairs[..., 1]], axis=-1)
    edges, number = np.unique(pairs.reshape(-1, 2), axis=0, return_inverse=True)
    number = number.reshape(-1, 3)
    long = np.zeros(len(edges), dtype=bool)
    # An edge is halved where it is too long; so neighbours agree about it.
    long[number[lengths > longest]] = True
    if not long.any():
        return points, triangles, False
    middles = np.full(len(edges), -1, dtype=np.int64)
    middles[long] = len(points) + np.arange(int(long.sum()))
    points = np.concatenate((points, points[edges[long]].mean(axis=1)))
    made: list[tuple[int, int, int]] = []
    for corners, mids in zip(triangles.tolist(), middles[number].tolist(), strict=True):
        made.extend(_parts(corners, mids, points))
    return points, np.array(made, dtype=np.int64), True


def _parts(corners: list[int], mids: list[int], points: FloatArray) -> list[tuple[int, int, int]]:
    """Return the triangles of one whose edges (0 1, 1 2, 2 0) have new middles, or -1."""
    cut = [k for k in range(3) if mids[k] >= 0]
    if not cut:
        return [(corners[0], corners[1], corners[2])]
    # Turn it so that the first edge is cut, and with two cut edges the last one is not.
    first = cut[0] if len(cut) != 2 else next(k for k in cut if mids[(k + 2) % 3] < 0)
    a, b, c = (corners[(first + k) % 3] for k in range(3))
    ab, bc, ca = (mids[(first + k) % 3] for k in range(3))
    if len(cut) == 1:
        return [(a, ab, c), (ab, b, c)]
    if len(cut) == 2:
        # The shorter diagonal of the square that is left.
        if np.linalg.norm(points[ab] - points[c]) < np.linalg.norm(points[a] - points[bc]):
            return [(ab, b, bc), (a, ab, c), (ab, bc, c)]
        return [(ab, b, bc), (a, ab, bc), (a, bc, c)]
    return [(a, ab, ca), (ab, b, bc), (ca, bc, c), (ab, bc, ca)]


def _thinned(points: FloatArray, areas: FloatArray, spacing: float) -> tuple[FloatArray, FloatArray]:
    """Return the point that is nearest to the mean of each cube that has any, with the area of all in it."""
    keys = np.floor((points - points.min(axis=0)) / spacing).astype(np.int64)
    _, owner = np.unique(keys, axis=0, return_inverse=True)
    owner = owner.ravel()
    count = int(owner.max()) + 1
    total, weights = np.zeros((count, 3, 3)), np.einsum("pii->p", areas)
    np.add.at(total, owner, areas)
    whole = np.bincount(owner, weights, count)
    means = np.stack([np.bincount(owner, points[:, axis] * weights, count) / whole for axis in range(3)], axis=-1)
    order = np.lexsort((np.linalg.norm(points - means[owner], axis=1), owner))
    chosen = order[np.concatenate(([True], np.diff(owner[order]) > 0))]
    return points[chosen], total[owner[chosen]]
