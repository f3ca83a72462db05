"""Mesh files read into triangles in metres, and hulls made small enough for fast contact."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from orbit_core.assets.mesh_files import open_mesh
from orbit_core.assets.naming import names_file
from orbit_core.assets.options import ReadOptions
from orbit_core.interfaces.errors import AssetError
from orbit_core.scene import Color, Mesh
from orbit_core.scene.pose import Vector3


@dataclass(frozen=True, eq=False)
class MeshPart:
    """The part of a mesh file that has one colour; ``None`` where the file gives no colour."""

    mesh: Mesh
    color: Color | None


@names_file
def load_mesh(
    path: Path | str,
    scale: Vector3 = (1.0, 1.0, 1.0),
    *,
    options: ReadOptions = ReadOptions(),
    model: Path | None = None,
) -> Mesh:
    """The triangles of an STL, OBJ, DAE, GLB or other mesh file, placed by its scene graph, in metres.

    A DAE file's unit is honoured and its up axis is not, as in ROS. ``scale`` may reflect: faces then turn round, so
    that they still look outward. Equal vertices are merged. ``model`` is the file that names the mesh, whose folder and
    packages hold what else the mesh names, such as pictures.

    Raises:
        AssetError: the file is missing, cannot be decoded or holds no triangle.
    """
    return _concatenated(_load(Path(path), scale, options, model))


@names_file
def load_parts(
    path: Path | str,
    scale: Vector3 = (1.0, 1.0, 1.0),
    *,
    options: ReadOptions = ReadOptions(),
    model: Path | None = None,
) -> tuple[MeshPart, ...]:
    """As :func:`load_mesh`, one part per colour in the file; a texture counts as its median colour.

    Raises:
        AssetError: as :func:`load_mesh`.
    """
    by_color: dict[Color | None, list[Any]] = {}
    for geometry in _load(Path(path), scale, options, model):
        by_color.setdefault(_color(geometry), []).append(geometry)
    return tuple(MeshPart(_concatenated(group), color) for color, group in by_color.items())


def simplified_hull(mesh: Mesh, directions: int = 32) -> Mesh:
    """The convex hull of the points of ``mesh`` that lie farthest in each of evenly spread directions.

    It lies within the exact hull, has at most ``directions`` + 6 vertices, and touches the exact hull's bounding box on
    all sides. Directions are a Fibonacci lattice (Gonzalez, Measurement of areas on a sphere, 2010) and the axes.
    """
    from trimesh.convex import convex_hull

    index = np.arange(directions) + 0.5
    polar, azimuth = np.arccos(1 - 2 * index / directions), np.pi * (1 + 5**0.5) * index
    spread = np.stack([np.cos(azimuth) * np.sin(polar), np.sin(azimuth) * np.sin(polar), np.cos(polar)], axis=1)
    spread = np.concatenate([spread, np.eye(3), -np.eye(3)])
    points = np.asarray(mesh.vertices, dtype=np.float64)
    hull = convex_hull(points[np.unique(np.argmax(points @ spread.T, axis=0))])
    return _mesh(hull.vertices, hull.faces)


def _load(path: Path, scale: Vector3, options: ReadOptions, model: Path | None) -> list[Any]:
    import trimesh

    if 0.0 in scale or not np.isfinite(scale).all():
        raise AssetError(f"mesh file '{path}' is scaled by {scale}: give finite factors that are not zero")
    scene = open_mesh(path, options, model or path)
    if scene.units not in (None, "meters"):
        scene = scene.convert_units("meters")
    geometries = [
        geometry for geometry in scene.dump() if isinstance(geometry, trimesh.Trimesh) and len(geometry.faces)
    ]
    if not geometries:
        raise AssetError(f"mesh file '{path}' holds no triangle: export it as a triangle mesh")
    for geometry in geometries:
        geometry.apply_transform(np.diag([*scale, 1.0]))
    return geometries


def _concatenated(geometries: list[Any]) -> Mesh:
    import trimesh

    bare = [trimesh.Trimesh(geometry.vertices, geometry.faces, process=False) for geometry in geometries]
    joined: Any = trimesh.util.concatenate(bare)
    joined.merge_vertices()
    joined.update_faces(joined.nondegenerate_faces(height=1e-10))
    joined.remove_unreferenced_vertices()
    return _mesh(joined.vertices, joined.faces)


def _mesh(vertices: Any, faces: Any) -> Mesh:
    return Mesh(np.ascontiguousarray(vertices, dtype=np.float32), np.ascontiguousarray(faces, dtype=np.int32))


def _color(geometry: Any) -> Color | None:
    if not geometry.visual.defined:
        return None
    material = getattr(geometry.visual, "material", None)
    if material is None:
        color = geometry.visual.main_color
    elif any(getattr(material, name, None) is not None for name in ("baseColorTexture", "image")):
        color = np.median(geometry.visual.to_color().vertex_colors, axis=0)
    else:
        color = material.main_color
    r, g, b, a = (round(float(channel) / 255.0, 4) for channel in color)
    return (r, g, b, a)
