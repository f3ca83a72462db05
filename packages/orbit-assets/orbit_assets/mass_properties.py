"""Mass, centre of mass and inertia of solids of uniform density."""

from __future__ import annotations

import math
from collections.abc import Iterable

import numpy as np
import numpy.typing as npt

from orbit_core.interfaces.errors import AssetError
from orbit_core.preparation.merge import MassProperties, combine
from orbit_core.scene import Box, Capsule, Cylinder, Geometry, Mesh, Shape, Sphere

FloatArray = npt.NDArray[np.float64]


def mass_properties(geometry: Geometry, *, mass: float | None = None, density: float | None = None) -> MassProperties:
    """Those of a solid of uniform density, in the geometry's own frame, from its mass (kg) or its density (kg/m^3).

    A mesh that does not enclose a volume counts as its convex hull.

    Raises:
        AssetError: not exactly one of ``mass`` and ``density`` is given, one is not positive, or the geometry has no
            volume.
    """
    if (mass is None) == (density is None):
        raise AssetError("mass properties need either a mass or a density: give exactly one of them")
    volume, center, gyration = _solid(geometry)
    total = mass if mass is not None else volume * (density or 0.0)
    if not (math.isfinite(total) and total > 0):
        raise AssetError(f"a {type(geometry).__name__.lower()} has a mass of {total} kg: give a positive one")
    return MassProperties(total, tuple(center.tolist()), total * gyration)


def shapes_mass_properties(shapes: Iterable[Shape], density: float) -> MassProperties:
    """Those of a body made of shapes of one density, in the body's frame. Where shapes overlap, mass counts twice.

    Raises:
        AssetError: there is no shape, or one without volume.
    """
    return combine(mass_properties(shape.geometry, density=density).placed(shape.pose) for shape in shapes)


def _solid(geometry: Geometry) -> tuple[float, FloatArray, FloatArray]:
    """Volume, centre of mass, and inertia about it per unit of mass."""
    match geometry:
        case Box(half_extents=half):
            squares = np.square(half)
            return 8.0 * math.prod(half), np.zeros(3), np.diag(squares.sum() - squares) / 3.0
        case Sphere(radius=r):
            return 4.0 / 3.0 * math.pi * r**3, np.zeros(3), np.eye(3) * 0.4 * r**2
        case Cylinder(radius=r, half_length=h):
            across = r**2 / 4.0 + h**2 / 3.0
            return 2.0 * math.pi * r**2 * h, np.zeros(3), np.diag((across, across, r**2 / 2.0))
        case Capsule(radius=r, half_length=h):
            return _capsule(r, h)
        case Mesh():
            return _mesh(geometry)
        case _:
            raise AssetError(f"a {type(geometry).__name__} encloses no volume: it can only be part of a static body")


def _capsule(r: float, h: float) -> tuple[float, FloatArray, FloatArray]:
    tube, caps = 2.0 * math.pi * r**2 * h, 4.0 / 3.0 * math.pi * r**3
    # A half ball's centre of mass stands 3/8 r from its flat face; the caps together are a ball cut and moved apart.
    across = tube * (r**2 / 4.0 + h**2 / 3.0) + caps * (0.4 * r**2 + h**2 + 0.75 * h * r)
    along = tube * r**2 / 2.0 + caps * 0.4 * r**2
    volume = tube + caps
    return volume, np.zeros(3), np.diag((across, across, along)) / volume


def _mesh(mesh: Mesh) -> tuple[float, FloatArray, FloatArray]:
    import trimesh

    vertices = np.asarray(mesh.vertices, dtype=float)
    if len(vertices) == 0 or np.linalg.matrix_rank(vertices - vertices.mean(0), tol=1e-6) < 3:
        raise AssetError(f"a mesh of {len(mesh.faces)} faces lies in a plane and has no volume: give it thickness")
    solid = trimesh.Trimesh(vertices, mesh.faces)
    if not (solid.is_watertight and solid.is_winding_consistent and solid.volume > 0):
        solid = solid.convex_hull
    volume = float(solid.volume)
    return volume, np.asarray(solid.center_mass, dtype=float), np.asarray(solid.moment_inertia, dtype=float) / volume
