"""Mesh files read into triangles in metres, with one colour per surface, and hulls small enough for fast contact."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from orbit_assets.mesh_files import bounded_pictures, open_mesh
from orbit_assets.naming import names_file, naming
from orbit_assets.options import ReadOptions
from orbit_core.interfaces.errors import AssetError
from orbit_core.scene import Color, Mesh
from orbit_core.scene.pose import Vector3

# Directions, in addition to the six along the axes, in which a simplified hull keeps the farthest point of the exact
# one.
_DIRECTIONS = 32


@dataclass(frozen=True, eq=False)
class MeshPart:
    """Part of a mesh file that has one colour; None where the file gives no colour.

    ``textured`` is True if the colour is computed from a picture.
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
    """Read the triangles of an STL, OBJ, DAE, GLB or other mesh file, placed by its scene graph, in metres.

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
    """Read the file's triangles as :func:`load_mesh` does, one part per colour; a texture counts as its median colour.

    Raises:
        AssetError: as :func:`load_mesh`.
    """
    return MeshFiles(options, Path(path)).parts(Path(path), scale)


class MeshFiles:
    """The mesh files of one model: each is decoded once, however many shapes and scales use it.

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
        """Return the triangles of a file, as :func:`load_mesh` reads them.

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
        """Return the parts of a file, as :func:`load_parts` reads them.

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
        # Most files have one colour: the whole mesh is then shared with the collision shape.
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
    """Return the convex hull of the points of ``mesh`` that are farthest in each of evenly spread directions.

    It is within the exact hull, has at most :data:`_DIRECTIONS` + 6 vertices, and touches the exact hull's bounding
    box on all sides. Directions are the axes and a Fibonacci lattice (Gonzalez, Measurement of areas on a sphere,
    2010).
    """
    from trimesh.convex import convex_hull

    # The Fibonacci lattice turns by the golden angle from one point to the next.
    index = np.arange(_DIRECTIONS) + 0.5
    polar, azimuth = np.arccos(1 - 2 * index / _DIRECTIONS), np.pi * (1 + 5**0.5) * index
    spread = np.stack([np.cos(azimuth) * np.sin(polar), np.sin(azimuth) * np.sin(polar), np.cos(polar)], axis=1)
    spread = np.concatenate([spread, np.eye(3), -np.eye(3)])
    points = np.asarray(mesh.vertices, dtype=np.float64)
    hull = convex_hull(points[np.unique(np.argmax(points @ spread.T, axis=0))])
    return Mesh(np.ascontiguousarray(hull.vertices, dtype=np.float32), np.ascontiguousarray(hull.faces, dtype=np.int32))


def _decoded(path: Path, options: ReadOptions, model: Path) -> list[Any]:
    """Decode the file's surfaces, placed by its scene graph, in metres."""
    import trimesh

    scene = open_mesh(path, options, model)
    # trimesh knows a unit for some formats only; without one the numbers are taken as metres.
    if scene.units not in (None, "meters"):
        scene = scene.convert_units("meters")
    geometries = [
        geometry for geometry in scene.dump() if isinstance(geometry, trimesh.Trimesh) and len(geometry.faces)
    ]
    if not geometries:
        raise AssetError(f"mesh file '{path}' holds no triangle: export it as a triangle mesh")
    return geometries


def _mesh(geometries: list[Any], scale: Vector3, path: Path) -> Mesh:
    """Join several surfaces into one mesh, scaled."""
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
    # A reflection turns triangles inside out: the reversed order of corners makes them face outward again.
    if np.prod(np.sign(scale)) < 0:
        joined = joined[:, ::-1]
    return Mesh(*merge_vertices(np.concatenate(vertices), joined))


# Metres of a triangle's height below which it is a line.
_THINNEST = 1e-10
# Odd numbers with evenly mixed bits (those of xxHash), which spread coordinates over 64 bits.
_PRIMES = (0x9E3779B97F4A7C15, 0xC2B2AE3D27D4EB4F, 0x165667B19E3779F9)


def merge_vertices(
    vertices: npt.NDArray[np.float32], faces: npt.NDArray[np.integer]
) -> tuple[npt.NDArray[np.float32], npt.NDArray[np.int32]]:
    """Merge equal points (V, 3), and remove triangles (F, 3) that are points or lines.

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
    """Find the distinct points.

    Points are sorted by a hash: three times faster than sorting rows, which remains for the rare collision.

    Returns:
        The index at which each distinct point is first met, ascending, and for every vertex the number of its point.
    """
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
    """Return True for each of the sorted rows that differs from the one before."""
    starts = np.ones(len(rows), dtype=bool)
    starts[1:] = np.any(rows[1:] != rows[:-1], axis=1)
    return starts


def _solid(vertices: npt.NDArray[np.float32], faces: npt.NDArray[np.intp]) -> npt.NDArray[np.bool_]:
    """Return True for each triangle that has a height."""
    a, b, c = (vertices[faces[:, corner]].astype(np.float64) for corner in range(3))
    doubled = np.linalg.norm(np.cross(b - a, c - a), axis=1)
    longest = np.max([np.linalg.norm(side, axis=1) for side in (b - a, c - b, a - c)], axis=0)
    return doubled > _THINNEST * longest


def surface_color(geometry: Any) -> tuple[Color | None, bool]:
    """Find the colour of a trimesh geometry.

    A picture counts as the median of the part that the surface shows, or of all of it where texture coordinates are
    missing.

    Returns:
        The colour, None where the file gives none, and True if it is computed from a picture.
    """
    visual = geometry.visual
    if not visual.defined:
        return None, False
    material = getattr(visual, "material", None)
    if material is None:
        return _color(visual.main_color), False
    picture = getattr(material, "baseColorTexture", None) or getattr(material, "image", None)
    if picture is None:
        return _color(material.main_color), False
    return _color(np.median(_shown(geometry, picture), axis=0)), True


def _shown(geometry: Any, picture: Any) -> Any:
    coordinates = getattr(geometry.visual, "uv", None)
    if coordinates is not None and np.shape(coordinates) == (len(geometry.vertices), 2):
        return geometry.visual.to_color().vertex_colors
    return np.asarray(picture.convert("RGBA")).reshape(-1, 4)


def _color(channels: Any) -> Color:
    # Four digits: 8 bits per channel resolve no more, and equal colours must compare equal.
    r, g, b, a = (round(float(channel) / 255.0, 4) for channel in channels)
    return (r, g, b, a)
