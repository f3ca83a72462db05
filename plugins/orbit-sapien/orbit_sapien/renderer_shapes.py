"""Visual shapes as SAPIEN's, and markers made of them."""

# pyright: reportAttributeAccessIssue=false

# SAPIEN's stubs ask for shapes of arrays that NumPy's types cannot express.
# pyright: reportArgumentType=false, reportReturnType=false

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt

from orbit_core.plugin_kit import meshes
from orbit_core.scene import (
    Box,
    Capsule,
    Color,
    Cylinder,
    HeightField,
    MarkerSpec,
    Mesh,
    Plane,
    Shape,
    Sphere,
)
from orbit_sapien.geometry import Z_TO_X
from orbit_sapien.native import native_pose, sapien

# Cosine up to which neighbouring triangles are shaded as one surface.
_SMOOTH = math.cos(math.radians(40.0))
Vertices = npt.NDArray[np.floating]


def base_color(color: Color) -> list[float]:
    """SAPIEN's colours are linear."""
    return [*(float(part) ** 2.2 for part in color[:3]), float(color[3])]


def material(color: Color, roughness: float = 0.6) -> sapien.render.RenderMaterial:
    """A dull surface; ``color`` is as it looks on a screen (sRGB), SAPIEN's are linear."""
    made = sapien.render.RenderMaterial()
    made.base_color = base_color(color)
    made.roughness, made.metallic, made.specular = roughness, 0.0, 0.4
    return made


def render_shape(shape: Shape, reach: float) -> sapien.render.RenderShape:
    """SAPIEN's shape, placed in its link; planes end at ``reach`` metres from their origin."""
    pose, look = shape.pose, material(shape.color)
    match shape.geometry:
        case Box(half_extents):
            made = sapien.render.RenderShapeBox(np.asarray(half_extents, np.float32), look)
        case Sphere(radius):
            made = _ball(radius, look)
        case Capsule(radius, half_length):
            made, pose = sapien.render.RenderShapeCapsule(radius, half_length, look), pose @ Z_TO_X
        case Cylinder(radius, half_length):
            made, pose = sapien.render.RenderShapeCylinder(radius, half_length, look), pose @ Z_TO_X
        case Plane():
            made = _mesh(*_square(reach), look)
        case Mesh() as mesh:
            made = _mesh(mesh.vertices, mesh.faces, look)
        case HeightField() as field:
            made = _mesh(*meshes.height_field_mesh(field), look)
    made.set_local_pose(native_pose(pose))
    return made


def marker_shapes(marker: MarkerSpec) -> list[sapien.render.RenderShape]:
    """Return the shapes of a marker, in its own frame."""
    return [render_shape(shape, marker.size) for shape in meshes.marker_shapes(marker)]


def _square(half: float) -> tuple[Vertices, npt.NDArray[np.integer]]:
    corners = half * np.array([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]], np.float32)
    return corners, np.array([[0, 1, 2], [0, 2, 3]], np.uint32)


def _ball(radius: float, look: sapien.render.RenderMaterial) -> sapien.render.RenderShapeTriangleMesh:
    """Finer than SAPIEN's own, whose facets show in depth."""
    rows, columns = 32, 64
    height, turn = np.meshgrid(np.linspace(0, np.pi, rows + 1), np.linspace(0, 2 * np.pi, columns + 1), indexing="ij")
    grid = np.stack((np.sin(height) * np.cos(turn), np.sin(height) * np.sin(turn), np.cos(height)), -1)
    normals = grid.reshape(-1, 3).astype(np.float32)
    corner = (np.arange(rows)[:, None] * (columns + 1) + np.arange(columns)).ravel()
    below, beside, across = corner + columns + 1, corner + 1, corner + columns + 2
    faces = np.concatenate((np.stack((corner, below, across), -1), np.stack((corner, across, beside), -1)))
    blank = np.zeros((len(normals), 2), np.float32)
    return sapien.render.RenderShapeTriangleMesh(radius * normals, faces.astype(np.uint32), normals, blank, look)


def _mesh(
    vertices: Vertices, faces: npt.NDArray[np.integer], look: sapien.render.RenderMaterial
) -> sapien.render.RenderShapeTriangleMesh:
    points, normals, indices = shaded(np.asarray(vertices, np.float64)[np.asarray(faces)])
    blank = np.zeros((len(points), 2), np.float32)
    return sapien.render.RenderShapeTriangleMesh(
        points.astype(np.float32), indices.astype(np.uint32), normals.astype(np.float32), blank, look
    )


def shaded(
    corners: npt.NDArray[np.float64],
) -> tuple[npt.NDArray[np.float64], npt.NDArray[np.float64], npt.NDArray[np.int64]]:
    """Vertices (V, 3) with normals (V, 3), and faces (F, 3) of indices, of triangles with corners (F, 3, 3).

    Faces that bend little share a vertex and its normal; where they bend more, each has a vertex with its own normal.
    """
    areas = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    flat = np.repeat(_normalized(areas), 3, axis=0)
    points = corners.reshape(-1, 3)
    _, first, group = np.unique(np.round(points * 1e6).astype(np.int64), axis=0, return_index=True, return_inverse=True)
    group = group.ravel()
    sums = np.zeros((len(first), 3))
    np.add.at(sums, group, np.repeat(areas, 3, axis=0))
    smooth = _normalized(sums)
    bends = (smooth[group] * flat).sum(-1) < _SMOOTH
    own = len(first) + np.cumsum(bends) - 1
    indices = np.where(bends, own, group).reshape(-1, 3)
    return np.concatenate((points[first], points[bends])), np.concatenate((smooth, flat[bends])), indices


def _normalized(vectors: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
    return vectors / np.maximum(np.linalg.norm(vectors, axis=-1, keepdims=True), 1e-30)
