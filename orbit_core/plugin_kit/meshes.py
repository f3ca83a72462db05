"""Shapes as triangles, for engines and renderers that have no such shape of their own."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from orbit_core.scene import HeightField


def height_field_mesh(field: HeightField) -> tuple[npt.NDArray[np.float64], npt.NDArray[np.int64]]:
    """Vertices (V, 3) and faces (F, 3), two a cell, whose normals point up."""
    heights = np.asarray(field.heights, np.float64)
    rows, columns = heights.shape
    x = np.linspace(-field.size[0] / 2, field.size[0] / 2, columns)
    y = np.linspace(-field.size[1] / 2, field.size[1] / 2, rows)
    vertices = np.stack((*np.meshgrid(x, y), heights), -1).reshape(-1, 3)
    corner = (np.arange(rows - 1)[:, None] * columns + np.arange(columns - 1)).ravel()
    right, above, across = corner + 1, corner + columns, corner + columns + 1
    faces = np.concatenate((np.stack((corner, right, across), -1), np.stack((corner, across, above), -1)))
    return vertices, faces
