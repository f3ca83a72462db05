"""Surfaces as triangles with normals and texture coordinates, so that every renderer shades and textures alike."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from orbit_core.plugin_kit.meshes import triangles
from orbit_core.scene import Mesh, Plane, Shape, Texture

# Cosine up to which neighbouring triangles are shaded as one surface
_SMOOTH = math.cos(math.radians(40.0))
# Axes on which a texture lies, on a surface that faces along x, y or z
_ACROSS = np.array(((1, 2), (0, 2), (0, 1)))


@dataclass(frozen=True, eq=False)
class TexturedSurface:
    """Triangles with normals and texture coordinates."""

    vertices: npt.NDArray[np.float64]
    """(V, 3) metres in the shape's frame."""
    normals: npt.NDArray[np.float64]
    """(V, 3) unit vectors."""
    coordinates: npt.NDArray[np.float64]
    """(V, 2) in pictures, from the lower left corner."""
    faces: npt.NDArray[np.int64]
    """(F, 3) of indices."""


def textured_surface(shape: Shape, texture: Texture) -> TexturedSurface:
    """Return the surface of a shape with the coordinates of its texture.

    A mesh has its own coordinates, or else as any other shape those of a picture that is laid on the two axes which
    each face faces least, its middle at the shape's origin.

    Raises:
        ConfigurationError: the shape is a plane, which has no end.
    """
    geometry = shape.geometry
    if isinstance(geometry, Mesh) and geometry.coordinates is not None:
        faces = np.asarray(geometry.faces)
        coordinates = np.asarray(geometry.coordinates, np.float64)[faces.ravel()]
        return _with_normals(np.asarray(geometry.vertices, np.float64)[faces], coordinates)
    mesh = triangles(geometry)
    corners = np.asarray(mesh.vertices)[np.asarray(mesh.faces)]
    facing = np.repeat(np.abs(mesh.face_normals).argmax(-1), 3)
    flat = np.take_along_axis(corners.reshape(-1, 3), _ACROSS[facing], axis=-1)
    return _with_normals(corners, flat / (texture.width, texture.height) + 0.5)


def _with_normals(corners: npt.NDArray[np.float64], coordinates: npt.NDArray[np.float64]) -> TexturedSurface:
    """Return triangles that share no corner: neighbours may take another side of the picture."""
    _, normals, indices = shaded(corners)
    faces = np.arange(3 * len(corners)).reshape(-1, 3)
    return TexturedSurface(corners.reshape(-1, 3), normals[indices.ravel()], coordinates, faces)


def bounded(shape: Shape, reach: float) -> Shape:
    """Return the shape, a plane as a square that ends ``reach`` metres from its middle."""
    if not isinstance(shape.geometry, Plane):
        return shape
    corners = reach * np.array([[-1.0, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]])
    return replace(shape, geometry=Mesh(corners, np.array([[0, 1, 2], [0, 2, 3]])))


def shaded(
    corners: npt.NDArray[np.float64],
) -> tuple[npt.NDArray[np.float64], npt.NDArray[np.float64], npt.NDArray[np.int64]]:
    """Return vertices (V, 3) with normals (V, 3), and faces (F, 3) of indices, of triangles with corners (F, 3, 3).

    At a vertex, faces that bend little against one another share a normal, the mean of theirs by area; where they bend
    more, each side has a vertex and a normal.
    """
    areas = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    flat, area = np.repeat(_normalized(areas), 3, axis=0), np.repeat(areas, 3, axis=0)
    points = corners.reshape(-1, 3)
    group = np.unique(np.round(points * 1e6).astype(np.int64), axis=0, return_inverse=True)[1].ravel()
    one, other = _pairs(group)
    near = (flat[one] * flat[other]).sum(-1) > _SMOOTH
    sums = np.stack([np.bincount(one[near], area[other[near], axis], len(points)) for axis in range(3)], axis=-1)
    # A triangle without area has no side: it keeps what it has, which is nothing.
    normals = _normalized(sums.astype(np.float64))
    keys = np.column_stack((group, np.round(normals * 1e5).astype(np.int64)))
    _, first, indices = np.unique(keys, axis=0, return_index=True, return_inverse=True)
    return points[first], normals[first], indices.reshape(-1, 3)


def _pairs(group: npt.NDArray[np.intp]) -> tuple[npt.NDArray[np.intp], npt.NDArray[np.intp]]:
    """Return all pairs of indices, in both orders and each with itself, that are of one group."""
    order = np.argsort(group, kind="stable")
    counts = np.bincount(group)
    starts = np.cumsum(counts) - counts
    size = counts[group[order]]
    one = np.repeat(order, size)
    # Within a group, 0, 1, 2 ... for each of its members.
    step = np.arange(len(one)) - np.repeat(np.cumsum(size) - size, size)
    return one, order[np.repeat(starts[group[order]], size) + step]


def _normalized(vectors: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
    return vectors / np.maximum(np.linalg.norm(vectors, axis=-1, keepdims=True), 1e-30)
