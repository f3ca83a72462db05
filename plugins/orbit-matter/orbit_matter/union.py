"""The outer surface of a body of many convex pieces: what is left of their faces where no other piece covers them."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt
import trimesh

FloatArray = npt.NDArray[np.float64]

_TOUCHING = 1e-5
"""Part of the extent of all pieces within which faces are in one plane."""


class _Piece:
    """A convex piece as its triangles (F, 3, 3) and as its planes: outward normals (F, 3) and their offsets (F,)."""

    def __init__(self, vertices: FloatArray) -> None:
        hull = trimesh.Trimesh(vertices, process=False).convex_hull
        self.triangles = np.asarray(hull.triangles, float)
        normals = np.asarray(hull.face_normals, float)
        planes = np.column_stack((normals, np.einsum("fk,fk->f", normals, self.triangles[:, 0])))
        scale = np.append(np.full(3, 1e6), 1e6 / max(float(np.ptp(vertices, axis=0).max()), 1e-9))
        kept = np.unique(np.round(planes * scale), axis=0, return_index=True)[1]
        self.normals, self.offsets = planes[kept, :3], planes[kept, 3]
        self.low, self.high = hull.bounds


def outer_surface(pieces: Sequence[FloatArray]) -> tuple[FloatArray, npt.NDArray[np.int64]]:
    """Return the vertices (V, 3) and faces (F, 3) around all of several convex pieces.

    Args:
        pieces: vertices (n, 3) of each, whose hull it is.
    """
    solids = [_Piece(np.asarray(vertices, float)) for vertices in pieces]
    extent = np.max([each.high for each in solids], axis=0) - np.min([each.low for each in solids], axis=0)
    near = _TOUCHING * float(extent.max())
    triangles: list[FloatArray] = []
    for n, own in enumerate(solids):
        others = [
            (m, other)
            for m, other in enumerate(solids)
            if m != n and (own.low <= other.high + near).all() and (other.low <= own.high + near).all()
        ]
        for triangle in own.triangles:
            left = [triangle]
            for m, other in others:
                left = [part for polygon in left for part in _beyond(polygon, other, m < n, near)]
            triangles += [polygon[[0, k, k + 1]] for polygon in left for k in range(1, len(polygon) - 1)]
    vertices = np.concatenate(triangles)
    return vertices, np.arange(len(vertices)).reshape(-1, 3)


def _beyond(polygon: FloatArray, piece: _Piece, is_first: bool, near: float) -> list[FloatArray]:
    """Return the parts of a polygon that a convex piece does not cover.

    Args:
        polygon: its corners (n, 3), in order.
        piece: what may cover it.
        is_first: True where a face that both share is the piece's.
        near: m within which the polygon is in the plane of a face.
    """
    heights = polygon @ piece.normals.T - piece.offsets
    if ((heights.min(axis=0) > -near) & (heights.max(axis=0) > near)).any():
        return [polygon]
    shared = piece.normals[np.abs(heights).max(axis=0) <= near]
    normal = np.cross(polygon[1] - polygon[0], polygon[2] - polygon[0])
    if not is_first and (shared @ normal > 0.0).any():
        return [polygon]
    found: list[FloatArray] = []
    for normal, offset in zip(piece.normals, piece.offsets, strict=True):
        height = polygon @ normal - offset
        if height.max() <= near:
            continue
        if height.min() >= -near:
            return [*found, polygon]
        found.append(_cut(polygon, height))
        polygon = _cut(polygon, -height)
    return found


def _cut(polygon: FloatArray, height: FloatArray) -> FloatArray:
    """Return the part of a convex polygon whose height is positive."""
    corners: list[FloatArray] = []
    for a, b, over, next_over in zip(polygon, np.roll(polygon, -1, axis=0), height, np.roll(height, -1), strict=True):
        if over >= 0.0:
            corners.append(a)
        if over * next_over < 0.0:
            corners.append(a + (b - a) * (over / (over - next_over)))
    return np.array(corners)
