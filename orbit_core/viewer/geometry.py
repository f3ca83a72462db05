"""Shapes as triangles with a colour, packed for the browser."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from orbit_core.interfaces import ConfigurationError
from orbit_core.plugin_kit.meshes import height_field_mesh
from orbit_core.scene import (
    Box,
    Capsule,
    Color,
    Cylinder,
    Geometry,
    HeightField,
    Mesh,
    Plane,
    Shape,
    Sphere,
)

if TYPE_CHECKING:
    from trimesh import Trimesh

CREASE_ANGLE = math.radians(30.0)
"""Edges sharper than this are drawn sharp."""


@dataclass(frozen=True, eq=False)
class Drawing:
    """Shapes in a frame of their own, ready to be drawn."""

    glb: bytes
    """Binary glTF, one mesh a colour."""
    corners: npt.NDArray[np.float64]
    """(8, 3) of the box round them."""

    @staticmethod
    def of(shapes: Iterable[Shape]) -> Drawing:
        """Triangles of one or more shapes.

        Raises:
            ConfigurationError: one is a plane, which has no end.
        """
        import trimesh
        from trimesh.visual import TextureVisuals

        by_color: dict[Color, list[Trimesh]] = {}
        for shape in shapes:
            mesh = triangles(shape.geometry)
            mesh.apply_transform(shape.pose.matrix())
            by_color.setdefault(shape.color, []).append(mesh)
        scene = trimesh.Scene()
        for color, meshes in by_color.items():
            joined: Any = trimesh.util.concatenate(meshes)
            joined.visual = TextureVisuals(material=_material(color))
            scene.add_geometry(joined)
        data = scene.export(file_type="glb", include_normals=True)
        assert isinstance(data, bytes)  # what a GLB export gives
        return Drawing(data, np.asarray(trimesh.bounds.corners(scene.bounds)))


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


def _material(color: Color) -> Any:
    from trimesh.visual.material import PBRMaterial

    # glTF's colours are linear in light; a screen's, as the scene's are, follow the sRGB curve.
    screen = np.asarray(color[:3])
    linear = np.where(screen <= 0.04045, screen / 12.92, ((screen + 0.055) / 1.055) ** 2.4)
    rgba = np.round(255.0 * np.array([*linear, color[3]])).astype(np.uint8)
    return PBRMaterial(
        baseColorFactor=rgba,
        metallicFactor=0.0,
        roughnessFactor=0.6,
        alphaMode="OPAQUE" if color[3] >= 1.0 else "BLEND",
    )
