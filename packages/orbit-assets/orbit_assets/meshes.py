"""Mesh files read into triangles in metres, and hulls made small enough for fast contact."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from orbit_assets.mesh_colors import surface_color
from orbit_assets.mesh_files import bounded_pictures, open_mesh
from orbit_assets.naming import names_file, naming
from orbit_assets.options import ReadOptions
from orbit_assets.vertices import merge_vertices
from orbit_core.interfaces.errors import AssetError
from orbit_core.scene import Color, Mesh
from orbit_core.scene.pose import Vector3

_DIRECTIONS = 32
"""Directions in which a simplified hull keeps the farthest point of the exact one, beside the six along the axes."""


@dataclass(frozen=True, eq=False)
class MeshPart:
    """The part of a mesh file that has one colour; ``None`` where the file gives no colour.

    ``textured`` tells that the colour stands for a picture.
    """

    mesh: Mesh
    color: Color | None
    textured: bool = False


@names_file
def load_mesh(
    path: Path | str,
    scale: Vector3 = (1.0, 1.0, 1.0),
    *,
    options: ReadOptions = ReadOptions(),
) -> Mesh:
    """The triangles of an STL, OBJ, DAE, GLB or other mesh file, placed by its scene graph, in metres.

    A DAE file's unit is honoured and its up axis is not, as in ROS. ``scale`` may reflect: faces then turn round, so
    that they still look outward. Vertices that are equal in single precision are merged.

    Raises:
        AssetError: the file is missing, cannot be decoded or holds no triangle.
    """
    return MeshFiles(options, Path(path)).mesh(Path(path), scale)


@names_file
def load_parts(
    path: Path | str,
    scale: Vector3 = (1.0, 1.0, 1.0),
    *,
    options: ReadOptions = ReadOptions(),
) -> tuple[MeshPart, ...]:
    """The file's triangles as :func:`load_mesh` reads them, one part per colour; a texture counts as its median colour.

    Raises:
        AssetError: as :func:`load_mesh`.
    """
    return MeshFiles(options, Path(path)).parts(Path(path), scale)


class MeshFiles:
    """The mesh files of one model: each is decoded once, whatever shapes and scales it is used for.

    Args:
        options: the limits, and what files may be opened.
        model: the file that names the meshes.
    """

    def __init__(self, options: ReadOptions, model: Path) -> None:
        self.options = options
        self.model = model
        self._decoded: dict[Path, list[Any]] = {}
        self._meshes: dict[tuple[Path, Vector3], Mesh] = {}
        self._parts: dict[tuple[Path, Vector3], tuple[MeshPart, ...]] = {}

    def mesh(self, path: Path, scale: Vector3 = (1.0, 1.0, 1.0)) -> Mesh:
        """The triangles of a file, as :func:`load_mesh` reads them.

        Raises:
            AssetError: as :func:`load_mesh`.
        """
        key = (path, scale)
        if key not in self._meshes:
            with naming(str(path)), bounded_pictures(self.options):
                parts = self._parts.get(key, ())
                # One part is the whole: its visual and its collision shape then share one mesh.
                self._meshes[key] = parts[0].mesh if len(parts) == 1 else _mesh(self._geometries(path), scale, path)
        return self._meshes[key]

    def parts(self, path: Path, scale: Vector3 = (1.0, 1.0, 1.0)) -> tuple[MeshPart, ...]:
        """The parts of a file, as :func:`load_parts` reads them.

        Raises:
            AssetError: as :func:`load_mesh`.
        """
        key = (path, scale)
        if key not in self._parts:
            with naming(str(path)), bounded_pictures(self.options):
                self._parts[key] = self._split(path, scale)
        return self._parts[key]

    def _split(self, path: Path, scale: Vector3) -> tuple[MeshPart, ...]:
        by_color: dict[tuple[Color | None, bool], list[Any]] = {}
        geometries = self._geometries(path)
        for geometry in geometries:
            by_color.setdefault(surface_color(geometry), []).append(geometry)
        if len(by_color) == 1:
            ((color, textured),) = by_color
            return (MeshPart(self.mesh(path, scale), color, textured),)
        return tuple(
            MeshPart(_mesh(group, scale, path), color, textured) for (color, textured), group in by_color.items()
        )

    def _geometries(self, path: Path) -> list[Any]:
        if path not in self._decoded:
            self._decoded[path] = _decoded(path, self.options, self.model)
        return self._decoded[path]


def simplified_hull(mesh: Mesh) -> Mesh:
    """The convex hull of the points of ``mesh`` that lie farthest in each of evenly spread directions.

    It lies within the exact hull, has at most :data:`_DIRECTIONS` + 6 vertices, and touches the exact hull's bounding
    box on all sides. Directions are the axes and a Fibonacci lattice (Gonzalez, Measurement of areas on a sphere,
    2010).
    """
    from trimesh.convex import convex_hull

    index = np.arange(_DIRECTIONS) + 0.5
    polar, azimuth = np.arccos(1 - 2 * index / _DIRECTIONS), np.pi * (1 + 5**0.5) * index
    spread = np.stack([np.cos(azimuth) * np.sin(polar), np.sin(azimuth) * np.sin(polar), np.cos(polar)], axis=1)
    spread = np.concatenate([spread, np.eye(3), -np.eye(3)])
    points = np.asarray(mesh.vertices, dtype=np.float64)
    hull = convex_hull(points[np.unique(np.argmax(points @ spread.T, axis=0))])
    return Mesh(np.ascontiguousarray(hull.vertices, dtype=np.float32), np.ascontiguousarray(hull.faces, dtype=np.int32))


def _decoded(path: Path, options: ReadOptions, model: Path) -> list[Any]:
    """The file's surfaces, placed by its scene graph, in metres."""
    import trimesh

    scene = open_mesh(path, options, model)
    if scene.units not in (None, "meters"):
        scene = scene.convert_units("meters")
    geometries = [
        geometry for geometry in scene.dump() if isinstance(geometry, trimesh.Trimesh) and len(geometry.faces)
    ]
    if not geometries:
        raise AssetError(f"mesh file '{path}' holds no triangle: export it as a triangle mesh")
    return geometries


def _mesh(geometries: list[Any], scale: Vector3, path: Path) -> Mesh:
    """Several surfaces as one mesh, scaled."""
    if 0.0 in scale or not np.isfinite(scale).all():
        raise AssetError(f"mesh file '{path}' is scaled by {scale}: give finite factors that are not zero")
    vertices: list[npt.NDArray[np.float32]] = []
    faces: list[npt.NDArray[np.int64]] = []
    first = 0
    for geometry in geometries:
        vertices.append((np.asarray(geometry.vertices) * scale).astype(np.float32))
        faces.append(np.asarray(geometry.faces, dtype=np.int64) + first)
        first += len(vertices[-1])
    joined = np.concatenate(faces)
    if np.prod(np.sign(scale)) < 0:
        joined = joined[:, ::-1]
    return Mesh(*merge_vertices(np.concatenate(vertices), joined))
