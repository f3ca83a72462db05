"""Limits of the solids' solver, found before anything runs."""

from __future__ import annotations

import itertools
import math

import numpy as np
import numpy.typing as npt

from orbit_core.interfaces import Approximation, ConfigurationError, SceneLayout
from orbit_core.scene import Box, Fluid, SoftBody
from orbit_matter.solids.distance import distances
from orbit_matter.solids.element import FloatArray
from orbit_matter.solids.grid import IntArray, cell_counts

_STIFFEST = 5e5
"""``E h^2 / (rho l^2)`` of a cell of edge l: a block of 5 cm kept its weight within 1e-6 and its shape within 1e-6 up
to 1.2e6, and diverged at 1.2e7, where single precision no longer resolves its strains."""
_OVERLAP = 0.1
"""Part of a solid's shortest side by which it may begin inside another."""
_FLATTEST = 200.0
"""Longest side over shortest from which on a solid that is too stiff for its step is too flat rather than too stiff."""
_LIGHTEST = 0.3
"""Part of a solid's mass that a free body should have: one of half of it and more came to rest on a block within
1 cm/s, one of a tenth hopped at up to 2 cm/s."""

_MOST_STRAIN = 0.3
"""Above it elements are too soft, being linear in their own axes."""
_HOLDS, _FAST = 0.5, 2.0
"""Part of a plate's thickness that a solid may come in a step and be held, and m/s that a plate should hold: plates of
0.5, 1, 2, 4 and 6 mm held 0, 0.5, 1, 1 and 2 m/s in steps of 1.25 ms, and none of them twice as much."""


def check_stiffness(layout: SceneLayout, steps: int) -> None:
    """Refuse solids that are too stiff for their step.

    Args:
        layout: of the scene.
        steps: of solids in a physics step.

    Raises:
        ConfigurationError: names the solid, and the ``physics_dt`` that would do.
    """
    # Only the shortest edge counts: along it waves cross a cell soonest.
    h = layout.scene.physics_dt / steps
    for spec in _solids(layout):
        extent = np.ptp(spec.rest_positions, axis=0)
        edge = float((extent / cell_counts(extent, spec.resolution)).min())
        most = math.sqrt(_STIFFEST * spec.density / spec.youngs_modulus) * edge
        if h > most:
            longest = float(extent.max())
            if _FLATTEST * float(extent.min()) < longest:
                raise ConfigurationError(
                    f"soft body '{spec.name}' is {float(extent.min()):.2g} m thick and {longest:.2g} m long, too flat "
                    f"for elements in steps of {h:.2g} s: make it thicker, or a Cloth"
                )
            raise ConfigurationError(
                f"soft body '{spec.name}' is too stiff for steps of {h:.2g} s at {spec.youngs_modulus:.3g} Pa and "
                f"elements of {edge:.2g} m: a physics_dt of {most:.2g} s would do, larger elements (resolution), or a "
                "rigid object"
            )


def check_apart(layout: SceneLayout) -> None:
    """Refuse solids that begin inside each other: what pushes them apart would throw them.

    Raises:
        ConfigurationError: names both, and by how much they overlap.
    """
    solids = _solids(layout)
    for one, other in itertools.permutations(solids, 2):
        points = other.pose.inverse().transform(one.pose.transform(_samples(one)))
        depth = -float(distances(other, points).min())
        if depth > _OVERLAP * float(np.ptp(one.rest_positions, axis=0).min()):
            raise ConfigurationError(
                f"soft body '{one.name}' begins {depth:.2g} m inside '{other.name}', which would throw it out: move "
                "one of them, or hold both by one mesh"
            )


def check_dry(layout: SceneLayout) -> None:
    """Refuse liquids that fill the same place as a solid.

    Raises:
        ConfigurationError: names both, and how many particles are inside.
    """
    for liquid in layout.scene.deformables:
        if not isinstance(liquid, Fluid):
            continue
        particles = liquid.pose.transform(liquid.rest_positions)
        for solid in _solids(layout):
            count = int((distances(solid, solid.pose.inverse().transform(particles)) < 0.0).sum())
            if count:
                raise ConfigurationError(
                    f"{count} of the {len(particles)} particles of '{liquid.name}' are inside soft body "
                    f"'{solid.name}' at the start: move one of them, or make the liquid smaller"
                )


def farthest(layout: SceneLayout) -> float:
    """Return the metres within which solids are looked for in the surfaces of meshes."""
    return max((float(np.ptp(spec.rest_positions, axis=0).max()) for spec in _solids(layout)), default=0.0)


def check_clear(layout: SceneLayout, depths: npt.NDArray[np.float32], links: IntArray) -> None:
    """Refuse solids that begin inside links or terrain, which would throw them out at metres a second.

    Args:
        layout: of the scene.
        depths: (D, S) m of each deformable in each shape.
        links: (S,) link of each shape; those of terrain have none of the layout's.

    Raises:
        ConfigurationError: names the solid and what it is in.
    """
    names = [link.name for link in layout.links]
    for number, spec in enumerate(layout.scene.deformables):
        if not isinstance(spec, SoftBody):
            continue
        most = _OVERLAP * float(np.ptp(spec.rest_positions, axis=0).min())
        shape = int(depths[number].argmax()) if depths.shape[1] else 0
        if depths.shape[1] and depths[number, shape] > most:
            link = int(links[shape])
            what = f"link '{names[link]}'" if 0 <= link < len(names) else "the terrain"
            raise ConfigurationError(
                f"soft body '{spec.name}' begins {depths[number, shape]:.2g} m inside {what}, which would throw it "
                f"out: move one of them; up to {most:.2g} m gives way gently"
            )


def _samples(spec: SoftBody) -> FloatArray:
    """Return vertices of a solid, and points within it: two solids at one place share all vertices."""
    vertices = spec.rest_positions
    between = 0.5 * (vertices + vertices.mean(axis=0))
    # Those of a ring are in its hole, where another solid may be.
    return np.concatenate((vertices, between[distances(spec, between) < 0.0]))


def light_bodies(layout: SceneLayout) -> tuple[Approximation, ...]:
    """Report free bodies that are so light that they may hop on a solid of the scene."""
    found: list[Approximation] = []
    for entity in layout.entities:
        if not entity.spec.is_free_body:
            continue
        mass = min(articulation.links[0].mass for articulation in entity.spec.alternatives)
        for spec in _solids(layout):
            if mass < _LIGHTEST * spec.mass:
                would = f"{_LIGHTEST * spec.mass:.2g} kg would do"
                why = f"it weighs {mass:.2g} kg and '{spec.name}' {spec.mass:.2g} kg: {would}"
                asked = f"resting on '{spec.name}'"
                found.append(Approximation(f"'{entity.name}'", asked, "hops by up to some cm/s", why))
    return tuple(found)


def squeezed(layout: SceneLayout) -> tuple[Approximation, ...]:
    """Report solids that their own weight squeezes further than their elements are right."""
    pull = np.asarray(layout.scene.gravity)
    found: list[Approximation] = []
    for spec in _solids(layout):
        # Pascals under the tallest column of it.
        pressure = spec.density * float(np.ptp(spec.pose.transform(spec.rest_positions) @ pull))
        if pressure > _MOST_STRAIN * spec.youngs_modulus:
            tall = float(np.ptp(spec.rest_positions, axis=0).max())
            why = (
                f"{pressure:.2g} Pa of its own weight rest on its {spec.youngs_modulus:.2g} Pa, and it is {tall:.2g} m "
                f"long: strains of more than {100.0 * _MOST_STRAIN:.0f} % are too soft; is its mesh in metres?"
            )
            found.append(Approximation(f"'{spec.name}'", "standing under its own weight", "sinks into itself", why))
    return tuple(found)


def thin_plates(layout: SceneLayout, h: float) -> tuple[Approximation, ...]:
    """Report plates that points of a solid pass in a step of ``h`` seconds where they come as fast as from a table."""
    solids = _solids(layout)
    if not solids:
        return ()
    wide = 0.5 * min(float(np.ptp(spec.rest_positions, axis=0).min()) for spec in solids)
    parts = [("the terrain", layout.scene.terrain)]
    parts += [
        (f"link '{link.name}' of '{entity.name}'", link.collisions)
        for entity in layout.entities
        for articulation in entity.spec.alternatives
        for link in articulation.links
    ]
    found: list[Approximation] = []
    for name, shapes in parts:
        plates = [sorted(shape.geometry.half_extents) for shape in shapes if isinstance(shape.geometry, Box)]
        thin = min((2.0 * a for a, b, _ in plates if b >= wide), default=math.inf)
        speed = _HOLDS * thin / h
        if speed < _FAST:
            asked, got = "holding soft bodies", f"lets those pass that meet it at more than {speed:.2g} m/s"
            why = f"it is {thin:.2g} m thick: {_FAST * h / _HOLDS:.2g} m hold what comes at {_FAST:g} m/s"
            found.append(Approximation(name, asked, got, why))
    return tuple(dict.fromkeys(found))


def _solids(layout: SceneLayout) -> tuple[SoftBody, ...]:
    return tuple(spec for spec in layout.scene.deformables if isinstance(spec, SoftBody))
