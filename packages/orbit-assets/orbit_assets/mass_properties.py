"""Mass, centre of mass and inertia of solids of uniform density."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import replace

import numpy as np
import numpy.typing as npt

from orbit_assets.options import ReadOptions, Repair
from orbit_core.interfaces.errors import AssetError
from orbit_core.preparation.merge import MassProperties, combine, link_hosts
from orbit_core.scene import Articulation, Box, Capsule, Cylinder, Geometry, Link, Mesh, Pose, Shape, Sphere
from orbit_core.scene.articulation import raised_moments

FloatArray = npt.NDArray[np.float64]


def mass_properties(geometry: Geometry, *, mass: float | None = None, density: float | None = None) -> MassProperties:
    """Return the mass properties of a uniform solid in the geometry's frame, from its mass (kg) or density (kg/m^3).

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
    """Return the mass properties of shapes of one density, in the body's frame. Overlaps count twice.

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


# Repair of inertias that no body can have, on request, with a note on each --------------------------------------------

# Least principal moment as a share of the largest; a thin rod's smallest one is about that.
_LEAST = 1e-3
# As in :mod:`orbit_core.preparation.validation`: published models round their inertias to three digits.
_TRIANGLE_TOLERANCE = 1e-3
# kg/m^3, of the ball that replaces an inertia of zero.
_WATER = 1000.0


def repaired(articulation: Articulation, options: ReadOptions) -> Articulation:
    """Return the articulation as read, or with its inertias balanced where the options say so."""
    return balance_inertias(articulation) if options.repair is Repair.BALANCE else articulation


def balance_inertias(articulation: Articulation) -> Articulation:
    """Replace inertias that no body can have by the nearest possible ones.

    Links joined by fixed joints are one body; where it is sound, its links stay as they are. Else each of its unsound
    links gets the nearest sound principal moments that are no smaller, about the same axes: each at least a thousandth
    of the largest, and the two smaller ones together no smaller than the largest (half of what lacks goes to each). A
    link with mass and an inertia of zero gets that of a ball of water of its mass. Masses stay as they are.
    """
    # Judged by rigid body, not by link: a model may split one body's inertia over links that alone are impossible.
    unsound = {name for body in _bodies(articulation) for name in _unsound_links(body)}
    if not unsound:
        return articulation
    links = tuple(_balanced(link) if link.name in unsound else link for link in articulation.links)
    changes = [
        f"'{old.name}' {_moments_text(old.inertia)} -> {_moments_text(new.inertia)}"
        for old, new in zip(articulation.links, links, strict=True)
        if new is not old
    ]
    note = f"principal moments (kg m^2) that no body has are raised: {', '.join(changes)}"
    return replace(articulation, links=links, notes=(*articulation.notes, note))


def balanced(inertia: npt.ArrayLike) -> npt.NDArray[np.float64]:
    """Return the inertia (3, 3), symmetric, with principal moments raised as :func:`balance_inertias` says.

    At least one principal moment must be positive.
    """
    tensor = np.asarray(inertia, dtype=float)
    moments, axes = np.linalg.eigh((tensor + tensor.T) / 2.0)
    return axes @ np.diag(raised_moments(np.maximum(moments, _LEAST * moments[2]))) @ axes.T


def _bodies(articulation: Articulation) -> list[list[tuple[Link, Pose]]]:
    """Group links that fixed joints join, each with its pose in its body."""
    hosts = link_hosts(articulation)
    bodies: dict[str, list[tuple[Link, Pose]]] = {}
    for link in articulation.links:
        host, pose = hosts[link.name]
        bodies.setdefault(host, []).append((link, pose))
    return list(bodies.values())


def _unsound_links(body: list[tuple[Link, Pose]]) -> list[str]:
    parts = [MassProperties(link.mass, link.center_of_mass, link.inertia).placed(pose) for link, pose in body]
    if not any(part.mass > 0 for part in parts) or _sound(combine(parts).inertia):
        return []
    return [link.name for link, _ in body if (link.mass > 0 or np.any(link.inertia)) and not _sound(link.inertia)]


def _sound(inertia: npt.NDArray[np.float64]) -> bool:
    if not np.isfinite(inertia).all() or not np.allclose(inertia, inertia.T, rtol=1e-6, atol=1e-12):
        return False
    small, middle, large = np.linalg.eigvalsh(inertia)
    return bool(small > 0 and small + middle >= large * (1 - _TRIANGLE_TOLERANCE))


def _balanced(link: Link) -> Link:
    if not np.isfinite(link.inertia).all():
        return link  # not to be guessed: validation names it
    if np.linalg.eigvalsh((link.inertia + link.inertia.T) / 2.0)[2] > 0:
        return replace(link, inertia=balanced(link.inertia))
    if link.mass <= 0:
        return link
    ball = Sphere((0.75 * link.mass / (math.pi * _WATER)) ** (1.0 / 3.0))
    return replace(link, inertia=mass_properties(ball, mass=link.mass).inertia)


def _moments_text(inertia: npt.NDArray[np.float64]) -> str:
    return "({:.3g}, {:.3g}, {:.3g})".format(*np.linalg.eigvalsh((inertia + inertia.T) / 2.0))
