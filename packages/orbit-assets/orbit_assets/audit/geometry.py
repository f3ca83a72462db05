"""Extents and volumes of links' shapes, each shape taken as its convex hull."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from orbit_assets.audit.mechanics import FloatArray
from orbit_assets.mass_properties import mass_properties
from orbit_core.interfaces.errors import AssetError
from orbit_core.scene import Box, Capsule, Cylinder, Geometry, Mesh, MeshCollision, Shape, Sphere

_ON_SPHERE, _ON_CIRCLE = 96, 24


def shape_points(shape: Shape) -> FloatArray:
    """Points (P, 3) in the link's frame whose hull is the shape's, round ones sampled; none of ground and terrain."""
    return shape.pose.transform(_points(shape.geometry))


def bounds(shapes: Iterable[Shape]) -> FloatArray | None:
    """The least and the greatest corner (2, 3) of all shapes in the link's frame; ``None`` where nothing has extent."""
    clouds = [cloud for shape in shapes if len(cloud := shape_points(shape))]
    if not clouds:
        return None
    points = np.concatenate(clouds)
    return np.stack([points.min(0), points.max(0)])


def colliding_volume(shape: Shape) -> float:
    """In m^3, of what other shapes meet: a mesh's hull if it collides as that; sheets and terrain have none."""
    from scipy.spatial import QhullError
    from trimesh.convex import convex_hull

    geometry = shape.geometry
    try:
        if isinstance(geometry, Mesh) and geometry.collision is MeshCollision.CONVEX_HULL:
            return float(convex_hull(np.asarray(geometry.vertices, dtype=np.float64)).volume)
        return mass_properties(geometry, density=1.0).mass
    except (AssetError, QhullError):
        return 0.0


def _points(geometry: Geometry) -> FloatArray:
    match geometry:
        case Box(half_extents=half):
            return np.array(np.meshgrid(*([-1.0, 1.0],) * 3)).reshape(3, -1).T * half
        case Sphere(radius=radius):
            return radius * _SPHERE
        case Capsule(radius=radius, half_length=half):
            return np.concatenate([radius * _SPHERE + (0.0, 0.0, side * half) for side in (-1.0, 1.0)])
        case Cylinder(radius=radius, half_length=half):
            return np.concatenate([_CIRCLE * (radius, radius, side * half) for side in (-1.0, 1.0)])
        case Mesh(vertices=vertices):
            return np.asarray(vertices, dtype=np.float64)
        case _:
            return np.zeros((0, 3))


def _sphere() -> FloatArray:
    """Points spread evenly on the unit sphere (a Fibonacci lattice), and those on its axes."""
    index = np.arange(_ON_SPHERE) + 0.5
    polar, azimuth = np.arccos(1 - 2 * index / _ON_SPHERE), np.pi * (1 + 5**0.5) * index
    spread = np.stack([np.cos(azimuth) * np.sin(polar), np.sin(azimuth) * np.sin(polar), np.cos(polar)], axis=1)
    return np.concatenate([spread, np.eye(3), -np.eye(3)])


def _circle() -> FloatArray:
    angle = np.linspace(0.0, 2.0 * np.pi, _ON_CIRCLE, endpoint=False)
    return np.stack([np.cos(angle), np.sin(angle), np.ones_like(angle)], axis=1)


_SPHERE, _CIRCLE = _sphere(), _circle()
