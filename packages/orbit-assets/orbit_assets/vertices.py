"""Vertices of a mesh that are the same point made one."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

_THINNEST = 1e-10
"""Metres of a triangle's height below which it is a line."""
_PRIMES = (0x9E3779B97F4A7C15, 0xC2B2AE3D27D4EB4F, 0x165667B19E3779F9)
"""Odd numbers with evenly mixed bits (those of xxHash), which spread coordinates over 64 bits."""


def merge_vertices(
    vertices: npt.NDArray[np.float32], faces: npt.NDArray[np.integer]
) -> tuple[npt.NDArray[np.float32], npt.NDArray[np.int32]]:
    """The same surface with each point (V, 3) once, and without triangles (F, 3) that are points or lines.

    Points keep the order in which they are first met; those of no triangle are left out.
    """
    vertices = vertices + np.float32(0.0)  # minus zero is zero
    first, which = _distinct(vertices)
    faces = which[faces]
    faces = faces[_solid(vertices[first], faces)]
    used = np.zeros(len(first), dtype=bool)
    used[faces] = True
    number = np.cumsum(used, dtype=np.int32) - 1
    return np.ascontiguousarray(vertices[first[used]]), np.ascontiguousarray(number[faces], dtype=np.int32)


def _distinct(vertices: npt.NDArray[np.float32]) -> tuple[npt.NDArray[np.intp], npt.NDArray[np.intp]]:
    """Where each distinct point is first met, ascending, and for every vertex which of them it is."""
    keys = np.zeros(len(vertices), dtype=np.uint64)
    for column, prime in zip(vertices.view(np.uint32).T, _PRIMES, strict=True):
        keys = (keys ^ column) * np.uint64(prime)
        keys ^= keys >> np.uint64(29)
    order = np.argsort(keys, kind="stable")
    starts = _starts(keys[order][:, None])
    if not np.array_equal(starts, _starts(vertices[order])):  # two points share a key: sort by what they are
        order = np.lexsort(vertices.T)
        starts = _starts(vertices[order])
    groups = np.cumsum(starts) - 1
    first = order[starts]  # sorting is stable: the first of each group comes first in the file
    rank = np.argsort(np.argsort(first))
    which = np.empty(len(vertices), dtype=np.intp)
    which[order] = rank[groups]
    return np.sort(first), which


def _starts(rows: npt.NDArray[np.generic]) -> npt.NDArray[np.bool_]:
    """For sorted rows, which differ from the one before."""
    starts = np.ones(len(rows), dtype=bool)
    starts[1:] = np.any(rows[1:] != rows[:-1], axis=1)
    return starts


def _solid(vertices: npt.NDArray[np.float32], faces: npt.NDArray[np.intp]) -> npt.NDArray[np.bool_]:
    """Which triangles have a height."""
    a, b, c = (vertices[faces[:, corner]].astype(np.float64) for corner in range(3))
    doubled = np.linalg.norm(np.cross(b - a, c - a), axis=1)
    longest = np.max([np.linalg.norm(side, axis=1) for side in (b - a, c - b, a - c)], axis=0)
    return doubled > _THINNEST * longest
