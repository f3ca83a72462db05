"""Height fields as closed surfaces of triangles, which liquids meet in their place."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from orbit_core.plugin_kit.meshes import height_field_mesh
from orbit_core.scene import HeightField, Mesh, MeshCollision

FloatArray = npt.NDArray[np.float64]

_BELOW = 10.0
"""Spacings of the liquid from the lowest point of a height field to its underside: no map reaches so far."""
_LEVEL = 0.1
"""Spacings of the liquid that a height field may rise by and count as level."""


def bounds_of(field: HeightField) -> FloatArray:
    """Return the lowest and the highest corner (2, 3) of a box around the surface of a height field, m."""
    x, y = field.size
    low, high = float(np.min(field.heights)), float(np.max(field.heights))
    return np.array([[-0.5 * x, -0.5 * y, low], [0.5 * x, 0.5 * y, high]])


def has_hollows(field: HeightField, spacing: float) -> bool:
    """Return True if a height field may hold a liquid of a spacing in metres: a level one acts as a plane."""
    return float(np.ptp(field.heights)) > _LEVEL * spacing


def closed_surface(field: HeightField, spacing: float) -> Mesh:
    """Return the surface of a height field with upright sides and an underside.

    Args:
        field: whose surface it is.
        spacing: of the liquid's particles, m.
    """
    vertices, faces = height_field_mesh(field)
    rows, columns = field.heights.shape
    number = np.arange(rows * columns).reshape(rows, columns)
    # Counter-clockwise from above; each vertex of the rim has one below it.
    rim = np.concatenate([number[0, :-1], number[:-1, -1], number[-1, :0:-1], number[:0:-1, 0]])
    floor = float(vertices[:, 2].min()) - _BELOW * spacing
    below = np.column_stack((vertices[rim, :2], np.full(len(rim), floor)))
    one = len(vertices) + np.arange(len(rim))
    upper, two, middle = np.roll(rim, -1), np.roll(one, -1), np.full(len(rim), len(vertices) + len(rim))
    sides = [np.stack(corners, axis=-1) for corners in ((rim, one, upper), (upper, one, two), (one, middle, two))]
    return Mesh(
        np.concatenate([vertices, below, [[0.0, 0.0, floor]]]),
        np.concatenate([faces, *sides]),
        MeshCollision.TRIANGLES,
    )
