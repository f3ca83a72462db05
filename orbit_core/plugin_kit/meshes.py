"""Shapes as triangles, for engines, renderers, the viewer and what looks at surfaces."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from orbit_core.interfaces.errors import ConfigurationError
from orbit_core.scene import Box, Capsule, Cylinder, Geometry, HeightField, Mesh, Plane, Sphere

if TYPE_CHECKING:
    from trimesh import Trimesh

CREASE_ANGLE = math.radians(30.0)
"""Edges sharper than this are drawn sharp."""


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


def triangles(geometry: Geometry) -> Trimesh:
    """The surface of a geometry in its own frame, with vertices doubled along sharp edges.

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
