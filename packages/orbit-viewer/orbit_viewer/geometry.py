"""Shapes as triangles with a colour, packed for the browser."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from orbit_core.plugin_kit.meshes import triangles
from orbit_core.scene import (
    Color,
    Shape,
)

if TYPE_CHECKING:
    from trimesh import Trimesh


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
