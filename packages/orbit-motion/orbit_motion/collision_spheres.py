"""A robot's collision shapes as balls, against which distances are cheap."""

from __future__ import annotations

import itertools
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from orbit_core.scene import Articulation, Box, Capsule, Cylinder, Mesh, Pose, Shape, Sphere

_Array = npt.NDArray[np.float64]
# Balls for one shape.
_MOST = 6
# m: boxes within this are fingertips, which go closer to things than their slices' balls would let them.
_SMALL = 0.03
# Points around a round shape.
_RING = 8


@dataclass(frozen=True)
class CollisionSpheres:
    """Balls (S,) that cover the collision shapes: their links' indices, centres (S, 3) in those, and radii, m."""

    links: npt.NDArray[np.int64]
    centers: _Array
    radii: _Array


def collision_spheres(articulation: Articulation) -> CollisionSpheres:
    """Balls around slices of each collision shape, cut across its longest direction.

    They cover the surface, and stand out of it by some centimetres on broad shapes. Planes and height fields, which no
    robot carries, are left out.
    """
    found = [
        (link, center, radius)
        for link, body in enumerate(articulation.links)
        for shape in body.collisions
        for center, radius in _balls(shape)
    ]
    links, centers, radii = zip(*found, strict=True) if found else ((), (), ())
    return CollisionSpheres(np.array(links, dtype=np.int64), np.array(centers).reshape(-1, 3), np.array(radii))


def _balls(shape: Shape) -> list[tuple[_Array, float]]:
    if isinstance(shape.geometry, Sphere):
        return [(np.asarray(shape.pose.position), shape.geometry.radius)]
    if isinstance(shape.geometry, Box) and 2.0 * max(shape.geometry.half_extents) < _SMALL:
        return _eighths(shape.geometry, shape.pose)
    points = _surface(shape)
    if not len(points):
        return []
    points = points @ shape.pose.rotation_matrix().T + np.asarray(shape.pose.position)
    middle = points.mean(0)
    axes = np.linalg.svd(points - middle, full_matrices=False)[2]
    along = (points - middle) @ axes[0]
    across = (points - middle) @ axes[1]
    length, width = np.ptp(along), max(np.ptp(across), 1e-3)
    count = int(np.clip(round(length / width) + 1, 1, _MOST))
    edges = np.linspace(along.min(), along.max(), count + 1)
    slack = length / count / 4
    return [
        _ball(points[(along >= low - slack) & (along <= high + slack)])
        for low, high in itertools.pairwise(edges)
        if ((along >= low - slack) & (along <= high + slack)).any()
    ]


def _eighths(box: Box, pose: Pose) -> list[tuple[_Array, float]]:
    """Around each part of a box that is halved in every direction, but in those in which it is thin."""
    half = np.asarray(box.half_extents)
    cells = np.where(half < 0.5 * half.max(), 1, 2)
    part = half / cells
    offsets = itertools.product(
        *[(np.arange(count) * 2 + 1 - count) * size for count, size in zip(cells, part, strict=True)]
    )
    turned = np.array(list(offsets)) @ pose.rotation_matrix().T + np.asarray(pose.position)
    return [(center, float(np.linalg.norm(part))) for center in turned]


def _ball(points: _Array) -> tuple[_Array, float]:
    center = (points.min(0) + points.max(0)) / 2
    for share in np.linspace(0.5, 0.02, 40):  # towards the furthest point, ever less: Badoiu and Clarkson, 2003
        furthest = points[np.linalg.norm(points - center, axis=1).argmax()]
        center = center + share * 0.2 * (furthest - center)
    return center, float(np.linalg.norm(points - center, axis=1).max())


def _surface(shape: Shape) -> _Array:
    """(P, 3) points on the surface, in the shape's frame."""
    geometry = shape.geometry
    grid = np.linspace(-1.0, 1.0, 7)
    if isinstance(geometry, Box):
        cube = np.stack(np.meshgrid(grid, grid, grid), -1).reshape(-1, 3)
        return cube[np.abs(cube).max(1) == 1.0] * np.asarray(geometry.half_extents)
    if isinstance(geometry, Capsule | Cylinder):
        angles = np.linspace(0.0, 2.0 * np.pi, _RING, endpoint=False)
        ring = np.stack((np.cos(angles), np.sin(angles), np.zeros(_RING)), 1) * geometry.radius
        rings = [ring + np.array([0.0, 0.0, z * geometry.half_length]) for z in grid]
        caps = geometry.half_length + (geometry.radius if isinstance(geometry, Capsule) else 0.0)
        return np.concatenate((*rings, [[0.0, 0.0, caps], [0.0, 0.0, -caps]]))
    if isinstance(geometry, Mesh):
        corners = np.asarray(geometry.vertices, dtype=np.float64)[np.asarray(geometry.faces)]
        middles = (corners + np.roll(corners, 1, axis=1)) / 2
        return np.concatenate((corners.reshape(-1, 3), middles.reshape(-1, 3), corners.mean(1)))
    return np.zeros((0, 3))
