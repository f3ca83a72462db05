"""Simplification of dense meshes to what pictures of some size can show.

Vertices within a cell of a grid become one, placed where it is nearest to the planes of their triangles (Lindstrom,
Out-of-Core Simplification of Large Polygonal Models, 2000). It takes milliseconds and keeps edges and silhouettes
within a cell.
"""

from __future__ import annotations

import functools
from dataclasses import replace
from typing import TypeVar

import numpy as np
import numpy.typing as npt

from orbit_core.interfaces import SceneLayout
from orbit_core.scene import Articulation, Mesh, ObjectSpec, RobotSpec, Shape

_Entity = TypeVar("_Entity", RobotSpec, ObjectSpec)

SIMPLIFIED = (
    "dense meshes are drawn as fine as the picture's height needs: a ball of 0.5 m in 72 rows of pixels is off by 8.8 "
    "mm of depth at most, and at 1.3 % of its outline by a pixel; with simplify_meshes=false by 0.3 mm and at 0.4 %"
)
"""Reason of renderers that draw simplified meshes for missing a depth."""
# Meshes of fewer triangles are drawn as they are.
_FEW = 400
# Cells along a mesh's diagonal for each pixel of the picture's height.
_CELLS = 0.22
# Weight of the cell's mean vertex next to the planes: it decides where planes leave a direction free.
_MEAN = 1e-3


def simplified(layout: SceneLayout, height: int) -> SceneLayout:
    """Return the layout with visual meshes as fine as pictures of ``height`` pixels need."""
    cells = max(8, round(_CELLS * height))
    scene = layout.scene
    robots = tuple(_entity(robot, cells) for robot in scene.robots)
    objects = tuple(_entity(thing, cells) for thing in scene.objects)
    if all(new is old for new, old in zip((*robots, *objects), scene.entities, strict=True)):
        return layout
    return SceneLayout.of(replace(scene, robots=robots, objects=objects))


def _entity(entity: _Entity, cells: int) -> _Entity:
    if not any(_dense(shape) for each in entity.alternatives for link in each.links for shape in link.visuals):
        return entity
    entity = replace(entity, articulation=_articulation(entity.articulation, cells))
    variants = getattr(entity, "variants", ())
    return replace(entity, variants=tuple(_articulation(each, cells) for each in variants)) if variants else entity


def _articulation(articulation: Articulation, cells: int) -> Articulation:
    links = (
        replace(link, visuals=tuple(_shape(shape, cells) for shape in link.visuals)) for link in articulation.links
    )
    return replace(articulation, links=tuple(links))


def _dense(shape: Shape) -> bool:
    # Texture coordinates have seams, which merging vertices would tear.
    mesh = shape.geometry
    return isinstance(mesh, Mesh) and len(mesh.faces) > _FEW and mesh.coordinates is None


def _shape(shape: Shape, cells: int) -> Shape:
    if not isinstance(shape.geometry, Mesh) or not _dense(shape):
        return shape
    return replace(shape, geometry=simplified_mesh(shape.geometry, cells))


# A robot's links are drawn by several renderers of a process, at one or two sizes.
@functools.lru_cache(maxsize=512)
def simplified_mesh(mesh: Mesh, cells: int) -> Mesh:
    """Return a mesh with at most one vertex in each of ``cells`` along its diagonal; itself if that removes little."""
    vertices, faces = np.asarray(mesh.vertices, np.float64), np.asarray(mesh.faces)
    low = vertices.min(0)
    size = float(np.linalg.norm(vertices.max(0) - low)) / cells
    places = np.floor((vertices - low) / size).astype(np.int64)
    width = places.max(0) + 1
    cluster = np.unique(places @ (width[1] * width[2], width[2], 1), return_inverse=True)[1].ravel()
    merged = cluster[faces]
    whole = (merged != np.roll(merged, 1, axis=1)).all(1)
    # Triangles that fall on one another count once.
    ordered = np.sort(merged[whole], axis=1)
    _, first = np.unique(ordered, axis=0, return_index=True)
    rows = np.flatnonzero(whole)[np.sort(first)]
    kept = merged[rows]
    if len(kept) > 0.7 * len(faces) or len(kept) < 4:
        return mesh
    points = _representatives(vertices, faces, cluster, size)
    # A triangle that merging has turned over would be culled, and leave a hole.
    over = (_areas(points[kept]) * _areas(vertices[faces[rows]])).sum(-1) < 0.0
    kept[over] = kept[over][:, ::-1]
    used, renumbered = np.unique(kept, return_inverse=True)
    return replace(mesh, vertices=points[used], faces=renumbered.reshape(-1, 3).astype(np.int32))


def _areas(corners: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
    """Return normals (F, 3) of triangles (F, 3, 3), as long as twice their area."""
    return np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])


def _representatives(
    vertices: npt.NDArray[np.float64], faces: npt.NDArray[np.integer], cluster: npt.NDArray[np.intp], size: float
) -> npt.NDArray[np.float64]:
    """Return (C, 3) the point of each cluster that is nearest to the planes of its triangles."""
    count = int(cluster.max()) + 1
    total = np.bincount(cluster, minlength=count)[:, None]
    mean = np.stack([np.bincount(cluster, vertices[:, axis], count) for axis in range(3)], axis=-1) / total
    corners = vertices[faces]
    normals = _areas(corners)
    # Each triangle counts with its area, at each of its corners, relative to that corner's cluster.
    owner = cluster[faces].ravel()
    planes = np.repeat(normals, 3, axis=0)
    area = np.maximum(np.linalg.norm(planes, axis=-1, keepdims=True), 1e-30)
    units = planes / area
    height = ((corners.reshape(-1, 3) - mean[owner]) * units).sum(-1, keepdims=True)
    left, right = np.zeros((count, 3, 3)), np.zeros((count, 3))
    for row in range(3):
        right[:, row] = np.bincount(owner, (area * units * height)[:, row], count)
        for column in range(3):
            left[:, row, column] = np.bincount(owner, (area[:, 0] * units[:, row] * units[:, column]), count)
    weight = _MEAN * np.trace(left, axis1=1, axis2=2)[:, None, None] + 1e-30
    moved = np.linalg.solve(left + weight * np.eye(3), right[..., None])[..., 0]
    # Nearly parallel planes meet far away: no further than the cell.
    return mean + moved.clip(-0.7 * size, 0.7 * size)
