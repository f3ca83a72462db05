"""Bounds of drawn shapes: points, discs and balls whose hull has the same extent as the shape in all directions."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from itertools import product

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor

from orbit_core.interfaces import SceneLayout
from orbit_core.scene import Box, Capsule, Cylinder, HeightField, Mesh, Shape, Sphere
from orbit_core.scene.shapes import Geometry

_Array = npt.NDArray[np.float64]
_CORNERS = np.array(list(product((-1.0, 1.0), repeat=3)))
# Number of vertices up to which a mesh's hull is not computed, because it would save less than it costs.
_FEW = 32


@dataclass(frozen=True)
class Rounds:
    """Points, discs and balls of one shape: a point has no radius, a ball no axis."""

    centres: _Array
    """Centres (P, 3)."""
    radii: _Array
    """Radii (P,)."""
    axes: _Array
    """Unit normals (P, 3) of discs, zero for balls and points."""

    @property
    def reach(self) -> _Array:
        """Extent (P, 3) of each from its centre along x, y and z."""
        return self.radii[:, None] * np.sqrt(1.0 - self.axes**2)


@dataclass(frozen=True)
class ShapeBounds:
    """Bounds of all drawn shapes of the entities, for each of K kinds of environment, in their links' frames.

    If a kind has fewer than another, its first ones are repeated, which changes no least or greatest value.
    """

    centres: Tensor
    """Centres (K, P, 3)."""
    radii: Tensor
    """Radii (K, P)."""
    axes: Tensor
    """Unit normals (K, P, 3), as of :class:`Rounds`."""
    shapes: Tensor
    """Index (K, P) int64 of the shape that each belongs to."""
    links: Tensor
    """Index (K, P) int64 of the scene's link that each belongs to."""
    corners: Tensor
    """Corners (K, S, 8, 3) of the box around each shape, along the shape's own axes."""
    shape_links: Tensor
    """Index (K, S) int64 of each shape's link."""


def bounded_links(layout: SceneLayout) -> list[int]:
    """Return the links of the scene that have shapes with bounds: all shapes except planes."""
    return [n for n, link in enumerate(layout.links) if any(map(_bounded, link.visuals or link.collisions))]


def shape_bounds(layout: SceneLayout, device: torch.device) -> ShapeBounds:
    """Compute the bounds of all drawn shapes of the entities, without planes, which have none."""
    kinds = [_kind(variant) for variant in layout.variants]
    columns = list(zip(*kinds, strict=True))
    tensors = [torch.as_tensor(_padded(column), device=device) for column in columns]
    return ShapeBounds(*(t if t.dtype == torch.int64 else t.to(torch.float32) for t in tensors))


def _kind(layout: SceneLayout) -> tuple[npt.NDArray[np.generic], ...]:
    """Compute the fields of :class:`ShapeBounds` for one kind of environment."""
    drawn = [
        (shape, n)
        for n, link in enumerate(layout.links)
        for shape in link.visuals or link.collisions
        if _bounded(shape)
    ]
    parts = [_in_link(shape) for shape, _ in drawn]
    sizes = [len(part.radii) for part in parts]
    shape_links = np.array([link for _, link in drawn], dtype=np.int64)
    return (
        _joined([part.centres for part in parts], (0, 3)),
        _joined([part.radii for part in parts], (0,)),
        _joined([part.axes for part in parts], (0, 3)),
        np.repeat(np.arange(len(drawn)), sizes),
        np.repeat(shape_links, sizes),
        np.array([_box_corners(shape) for shape, _ in drawn]).reshape(-1, 8, 3),
        shape_links,
    )


def _joined(arrays: list[_Array], empty: tuple[int, ...]) -> _Array:
    return np.concatenate(arrays) if arrays else np.zeros(empty)


def _padded(arrays: tuple[npt.NDArray[np.generic], ...]) -> npt.NDArray[np.generic]:
    # The first row may be repeated because it changes neither least nor greatest values.
    most = max(len(array) for array in arrays)
    return np.stack([np.concatenate((array, np.repeat(array[:1], most - len(array), 0))) for array in arrays])


def _bounded(shape: Shape) -> bool:
    return isinstance(shape.geometry, Box | Sphere | Capsule | Cylinder | Mesh | HeightField)


def _in_link(shape: Shape) -> Rounds:
    own = _rounds(shape.geometry)
    return Rounds(shape.pose.transform(own.centres), own.radii, own.axes @ shape.pose.rotation_matrix().T)


def _box_corners(shape: Shape) -> _Array:
    own = _rounds(shape.geometry)
    low, high = (own.centres - own.reach).min(0), (own.centres + own.reach).max(0)
    return shape.pose.transform(np.where(_CORNERS < 0.0, low, high))


def _rounds(geometry: Geometry) -> Rounds:
    """Return the points, discs and balls of a shape in its own frame."""
    match geometry:
        case Box():
            return _points(_CORNERS * geometry.half_extents)
        case Sphere():
            return Rounds(np.zeros((1, 3)), np.array([geometry.radius]), np.zeros((1, 3)))
        case Capsule():
            return Rounds(_ends(geometry.half_length), np.full(2, geometry.radius), np.zeros((2, 3)))
        case Cylinder():
            return Rounds(_ends(geometry.half_length), np.full(2, geometry.radius), np.array([(0.0, 0.0, 1.0)] * 2))
        case Mesh():
            return _points(_hull_points(geometry))
        case HeightField():
            rows, columns = geometry.heights.shape
            x, y = (0.5 * size for size in geometry.size)
            grid_y, grid_x = np.meshgrid(np.linspace(-y, y, rows), np.linspace(-x, x, columns), indexing="ij")
            return _points(np.stack((grid_x, grid_y, geometry.heights.astype(np.float64)), -1).reshape(-1, 3))
    raise AssertionError("a plane has no bounds")


def _points(points: _Array) -> Rounds:
    return Rounds(points, np.zeros(len(points)), np.zeros((len(points), 3)))


def _ends(half_length: float) -> _Array:
    return np.array([(0.0, 0.0, -half_length), (0.0, 0.0, half_length)])


@lru_cache(maxsize=1024)
def _hull_points(mesh: Mesh) -> _Array:
    """Return the vertices of a mesh's hull: a detailed mesh has a hundred times as many."""
    points = np.asarray(mesh.vertices, dtype=np.float64)[np.unique(mesh.faces)]
    if len(points) <= _FEW:
        return points
    try:
        from scipy.spatial import ConvexHull, QhullError
    except ImportError:  # an optional package: without it all vertices give the same boxes, but take longer
        return points
    try:
        return points[ConvexHull(points).vertices]
    except QhullError:  # a flat mesh has no hull with a volume
        return points
