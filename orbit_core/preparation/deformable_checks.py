"""Whether the numbers of a deformable can be, and what it names is there."""

from __future__ import annotations

import math

import numpy as np

from orbit_core.interfaces.divergence import MAX_DISTANCE
from orbit_core.interfaces.errors import ArgumentError
from orbit_core.interfaces.typed import wrong
from orbit_core.preparation.surface_checks import extents
from orbit_core.scene import Cloth, DeformableSpec, Fluid, Rope, Scene, SoftBody

_POSITIVE = {
    Cloth: ("area_density", "membrane_stiffness", "thickness"),
    Rope: ("linear_density", "axial_stiffness", "radius"),
    SoftBody: ("density", "youngs_modulus"),
    Fluid: ("density", "spacing"),
}
_NOT_NEGATIVE = {
    Cloth: ("bending_stiffness", "damping", "friction"),
    Rope: ("bending_stiffness", "damping", "friction"),
    SoftBody: ("damping", "friction"),
    Fluid: ("viscosity",),
}
_LARGEST = 1e12
_SOFTEST = 1e-3
"""N/m of a membrane: a thousandth of what a soap film has, below which its strains overflow single precision."""
_MOST_PARTICLES = 1_000_000
_LEAST_AREA = 1e-6
"""Of a triangle, over the mean of its mesh."""
_LEAST_VOLUME = 1e-4
"""Of a solid, over that of the box around it."""


def check_deformable(spec: DeformableSpec, where: str) -> None:
    """Hold a deformable's numbers to what they may be.

    Raises:
        ArgumentError: names the field, its value and what is wanted.
    """
    if not spec.name.strip():
        raise ArgumentError(f"{where} has no name: give it one, by which the world is asked for it")
    for names, least in ((_POSITIVE, 1e-12), (_NOT_NEGATIVE, 0.0)):
        for name in names[type(spec)]:
            if not least <= getattr(spec, name) <= _LARGEST:
                raise wrong(f"{where}.{name}", getattr(spec, name), f"{least:g} to {_LARGEST:g}")
    if isinstance(spec, Cloth) and spec.membrane_stiffness < _SOFTEST:
        raise wrong(f"{where}.membrane_stiffness", spec.membrane_stiffness, f"{_SOFTEST:g} to {_LARGEST:g} N/m")
    if isinstance(spec, Fluid):
        _check_box(spec, where)
    if isinstance(spec, Cloth | SoftBody) and not -1.0 < spec.poissons_ratio < 0.5 + 0.5 * isinstance(spec, Cloth):
        most = "1" if isinstance(spec, Cloth) else "0.5"
        raise wrong(f"{where}.poissons_ratio", spec.poissons_ratio, f"more than -1 and less than {most}")
    if isinstance(spec, Rope) and (np.ndim(spec.points) != 2 or np.shape(spec.points)[1] != 3):
        raise ArgumentError(f"{where}.points has shape {np.shape(spec.points)}: give (particles, 3)")
    if isinstance(spec, Rope) and len(spec.points) < 2:
        raise ArgumentError(f"{where}.points has {len(spec.points)} particles: give two or more")
    count = len(spec.rest_positions)
    if count > _MOST_PARTICLES:
        raise ArgumentError(f"{where} has {count} particles: give {_MOST_PARTICLES} at most")
    if not (np.abs(spec.rest_positions) <= MAX_DISTANCE).all():
        raise ArgumentError(f"{where} has particles that are not finite, or beyond {MAX_DISTANCE:g} m: mend them")
    if isinstance(spec, Cloth | Rope):
        _check_size(spec, where)
    if isinstance(spec, Cloth | SoftBody):
        _check_triangles(spec, where)
    if isinstance(spec, SoftBody) and extents(spec.mesh.vertices) < 3:
        raise ArgumentError(
            f"{where}.mesh lies in a plane and has no volume: give it a closed surface, or make it a Cloth"
        )
    if isinstance(spec, SoftBody):
        _check_solid(spec, where)
    _check_particles(spec, count)


def _check_particles(spec: DeformableSpec, count: int) -> None:
    """Refuse key points that have no name, or another's, and what is of particles that are not there."""
    names = [point.name for point in spec.key_points]
    if twice := [name for name in names if names.count(name) > 1]:
        raise ArgumentError(f"two key points of '{spec.name}' are named '{twice[0]}': give each its own name")
    for number, point in enumerate(spec.key_points):
        if not point.name.strip():
            raise ArgumentError(
                f"key point {number} of '{spec.name}' has no name: give it one, by which it is asked for"
            )
        if len(set(point.particles)) < len(point.particles):
            raise ArgumentError(
                f"key point '{point.name}' of '{spec.name}' names a particle twice: give it more weight"
            )
        if point.weights and abs(sum(point.weights) - 1.0) > 1e-3:
            raise ArgumentError(
                f"the weights of key point '{point.name}' of '{spec.name}' sum up to {sum(point.weights):g}: make it 1"
            )
    named = [(f"key point '{point.name}'", point.particles) for point in spec.key_points]
    named += [(f"attachment {number}", held.particles) for number, held in enumerate(spec.attachments)]
    for what, particles in named:
        if missing := [particle for particle in particles if not 0 <= particle < count]:
            raise ArgumentError(f"{what} of '{spec.name}' is of particle {missing[0]}: it has {count}, from 0 on")


def _check_box(fluid: Fluid, where: str) -> None:
    """Refuse a box that is none, or holds more particles than any solver takes."""
    for half in fluid.half_extents:
        if not 0.0 < half <= MAX_DISTANCE:
            raise wrong(
                f"{where}.half_extents", fluid.half_extents, f"three lengths above 0, {MAX_DISTANCE:g} m at most"
            )
    count = math.prod(max(1.0, 2.0 * half / fluid.spacing) for half in fluid.half_extents)
    if count > _MOST_PARTICLES:
        raise ArgumentError(
            f"{where} has {count:.3g} particles at a spacing of {fluid.spacing:g} m: give {_MOST_PARTICLES} at most"
        )


def _check_triangles(thing: Cloth | SoftBody, where: str) -> None:
    """Refuse triangles that have no area or are there twice, and particles that nothing holds."""
    points, faces = thing.rest_positions, np.asarray(thing.mesh.faces)
    a, b, c = (points[faces[:, corner]] for corner in range(3))
    areas = np.linalg.norm(np.cross(b - a, c - a), axis=1)
    if flat := np.flatnonzero(areas < _LEAST_AREA * areas.mean()).tolist():
        raise ArgumentError(f"triangle {flat[0]} of {where}.mesh has no area: leave it out, or mend the mesh")
    _, counts = np.unique(np.sort(faces, axis=1), axis=0, return_counts=True)
    if (counts > 1).any():
        raise ArgumentError(f"{where}.mesh has a triangle twice, which would weigh and resist twice: leave one out")
    held = np.zeros(len(points), dtype=bool)
    held[faces] = True
    if not held.all():
        raise ArgumentError(f"particle {int(held.argmin())} of {where}.mesh is in no triangle: leave it out")


def _check_solid(solid: SoftBody, where: str) -> None:
    """Refuse a surface that is not closed or inside out, and elements that are longer than none."""
    resolution = solid.resolution
    if resolution is not None and not 1e-6 <= resolution <= MAX_DISTANCE:
        raise wrong(f"{where}.resolution", resolution, f"1e-06 to {MAX_DISTANCE:g} m, or None")
    points, faces = solid.rest_positions, np.asarray(solid.mesh.faces)
    edges = np.stack((faces, np.roll(faces, -1, axis=1)), -1).reshape(-1, 2)
    forth = {(a, b) for a, b in edges.tolist()}
    loose = next(((a, b) for a, b in edges.tolist() if (b, a) not in forth), None)
    if loose is None and len(forth) < len(edges):
        pairs, counts = np.unique(edges, axis=0, return_counts=True)
        loose = tuple(pairs[counts.argmax()].tolist())
    if loose is not None:
        raise ArgumentError(
            f"{where}.mesh is not closed at the edge of vertices {loose[0]} and {loose[1]}, which is not that of two "
            "triangles that wind the same way: close it, merge vertices at one place, or turn triangles over"
        )
    a, b, c = (points[faces[:, corner]] - points.mean(axis=0) for corner in range(3))
    share = float(np.einsum("ij,ij->", a, np.cross(b, c)) / 6.0 / np.prod(np.ptp(points, axis=0)))
    if share < _LEAST_VOLUME:
        fault = "is inside out" if share < -_LEAST_VOLUME else "encloses hardly any volume"
        raise ArgumentError(
            f"{where}.mesh {fault}: have its triangles wind counter-clockwise as seen from outside, or make it a Cloth"
        )


def _check_size(spec: Cloth | Rope, where: str) -> None:
    """Refuse what is thicker than it is long: its particles would meet everything that is near."""
    extent = float(np.ptp(spec.rest_positions, axis=0).max())
    if isinstance(spec, Rope):
        lengths = np.linalg.norm(np.diff(spec.rest_positions, axis=0), axis=1)
        extent = float(lengths.sum())
        if (same := np.flatnonzero(~(lengths > 0.0))).size:
            raise ArgumentError(
                f"particles {same[0]} and {same[0] + 1} of {where}.points are at one place: leave one of them out"
            )
    if extent <= 0.0:
        raise ArgumentError(f"{where} has all of its particles at one place: give it a size")
    name = "thickness" if isinstance(spec, Cloth) else "radius"
    if getattr(spec, name) > extent:
        raise wrong(f"{where}.{name}", getattr(spec, name), f"{extent:g} m at most, which is its own length")


def check_attachments(scene: Scene) -> None:
    """Refuse attachments to what the scene lacks, and deformables of one name.

    Raises:
        ArgumentError: names the deformable and the entity or link.
    """
    links = {entity.name: entity.articulation.link_names for entity in scene.entities}
    names = [spec.name for spec in scene.deformables]
    if len(set(names)) < len(names):
        raise ArgumentError(f"two deformables share a name, of {', '.join(names)}: give each its own")
    for spec in scene.deformables:
        held_particles = [particle for held in spec.attachments for particle in set(held.particles)]
        if twice := [particle for particle in held_particles if held_particles.count(particle) > 1]:
            raise ArgumentError(
                f"two attachments of '{spec.name}' hold particle {twice[0]}: leave it to one, which alone can hold it"
            )
        if spec.name in links:
            raise ArgumentError(f"deformable '{spec.name}' has the name of a robot or an object: give it its own")
        for number, held in enumerate(spec.attachments):
            if not held.particles:
                raise ArgumentError(
                    f"attachment {number} of '{spec.name}' holds no particles: name some, or leave it out"
                )
            if held.entity is None and held.link is not None:
                raise ArgumentError(
                    f"attachment {number} of '{spec.name}' is to link '{held.link}' of no entity: name the entity too"
                )
            if held.entity is None:
                continue
            if held.link is None and held.entity in links:
                raise ArgumentError(
                    f"attachment {number} of '{spec.name}' is to no link of '{held.entity}': name one of "
                    f"{', '.join(links[held.entity])}"
                )
            if held.entity not in links:
                raise ArgumentError(f"an attachment of '{spec.name}' is to '{held.entity}': the scene has {[*links]}")
            if held.link not in links[held.entity]:
                raise ArgumentError(
                    f"an attachment of '{spec.name}' is to link '{held.link}' of '{held.entity}', which has "
                    f"{', '.join(links[held.entity])}"
                )
