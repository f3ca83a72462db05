"""Visual shapes as SAPIEN's, and markers made of them."""

# pyright: reportAttributeAccessIssue=false

# SAPIEN's stubs ask for shapes of arrays that NumPy's types cannot express.
# pyright: reportArgumentType=false, reportReturnType=false

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from orbit_core.plugin_kit import meshes
from orbit_core.plugin_kit.surfaces import bounded, shaded, textured_surface
from orbit_core.scene import (
    Box,
    Capsule,
    Color,
    Cylinder,
    Finish,
    HeightField,
    MarkerSpec,
    Mesh,
    Plane,
    Shape,
    Sphere,
    Texture,
)
from orbit_sapien.geometry import Z_TO_X
from orbit_sapien.native import native_pose, sapien

# Roughness of a surface whose finish says nothing
_PLAIN = 0.6
Vertices = npt.NDArray[np.floating]


def base_color(color: Color) -> list[float]:
    """SAPIEN's colours are linear."""
    return [*(float(part) ** 2.2 for part in color[:3]), float(color[3])]


def material(color: Color, finish: Finish) -> sapien.render.RenderMaterial:
    """Return SAPIEN's material; ``color`` is as it looks on a screen (sRGB), SAPIEN's are linear."""
    made = sapien.render.RenderMaterial()
    made.base_color = base_color(color)
    # A finish that says nothing is drawn a little glossy, as surfaces are that were never described.
    made.roughness, made.metallic, made.specular = min(finish.roughness, _PLAIN), finish.metallic, 0.4
    if (texture := finish.texture) is not None:
        # Rows count from below.
        pixels = texture.pixels[::-1]
        opaque = np.full((*pixels.shape[:2], 1), 255.0 * color[3] + 0.5)
        made.base_color_texture = sapien.render.RenderTexture2D(
            np.ascontiguousarray(np.concatenate((pixels, opaque), -1).astype(np.uint8)), "R8G8B8A8Unorm",
            mipmap_levels=_levels(texture), srgb=True,
        )  # fmt: skip
    return made


def _levels(texture: Texture) -> int:
    """Return how often a texture is halved, so that it does not flicker far away."""
    return max(1, int(np.log2(min(texture.pixels.shape[:2]))))


def render_shape(shape: Shape, reach: float) -> sapien.render.RenderShape:
    """SAPIEN's shape, placed in its link; planes end at ``reach`` metres from their origin."""
    pose, look = shape.pose, material(shape.color, shape.finish)
    if (texture := shape.finish.texture) is not None:
        surface = textured_surface(bounded(shape, reach), texture)
        made = sapien.render.RenderShapeTriangleMesh(
            surface.vertices.astype(np.float32), surface.faces.astype(np.uint32), surface.normals.astype(np.float32),
            surface.coordinates.astype(np.float32), look,
        )  # fmt: skip
        made.set_local_pose(native_pose(pose))
        return made
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
