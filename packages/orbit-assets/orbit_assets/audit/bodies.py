"""Checks of each link: its mass and inertia against its shapes, and what collides against what is seen."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass

import numpy as np

from orbit_assets.audit.findings import Finding, Severity
from orbit_assets.audit.geometry import bounds, colliding_volume
from orbit_assets.audit.mechanics import FloatArray
from orbit_assets.mass_properties import mass_properties
from orbit_core.interfaces.errors import AssetError
from orbit_core.scene import Link, Shape
from orbit_core.scene.inertias import principal_axes

_LIGHTEST, _HEAVIEST = 20.0, 25_000.0
"""kg/m^3 of a link's shapes taken as solid: stiff foam, and beyond tungsten."""
_OUTSIDE = 0.1
"""Of the bounding box's diagonal: how far outside the box a centre of mass may lie."""
_TOO_SMALL = 0.01
"""Of a solid box's least moment."""
_UNLIKE = 1.5
"""Ratio of volumes, or of lengths of bounding boxes, of what collides and what is seen."""


@dataclass(frozen=True, eq=False)
class Body:
    """A link's mass properties and the size of its shapes. Lengths in metres, moments in kg m^2 ascending."""

    name: str
    mass: float
    moments: tuple[float, float, float]
    size: tuple[float, float, float] | None
    """Of the bounding box of all shapes in the link's axes."""
    density: float | None
    """kg/m^3 over the volume of the visible shapes, of the colliding ones where none is seen."""
    collision_volume: float
    visual_volume: float


def measure_body(link: Link) -> Body:
    """Measure one link."""
    box = bounds((*link.collisions, *link.visuals))
    low, middle, high = (float(moment) for moment in principal_axes(link.inertia)[0])
    visual = solid_volume(link.visuals)
    solid = visual or solid_volume(link.collisions)
    return Body(
        link.name,
        link.mass,
        (low, middle, high),
        None if box is None else _triple(box[1] - box[0]),
        link.mass / solid if solid > 0 else None,
        sum(map(colliding_volume, link.collisions)),
        visual,
    )


def solid_volume(shapes: Iterable[Shape]) -> float:
    """The sum of the shapes' volumes in m^3; sheets and terrain have none, open meshes count as their hulls."""
    total = 0.0
    for shape in shapes:
        try:
            total += mass_properties(shape.geometry, density=1.0).mass
        except AssetError:
            continue
    return total


def check_body(link: Link, body: Body) -> Iterator[Finding]:
    """Findings on one link of a description without fixed joints. A root without mass is a fixed base."""
    if link.mass > 0:
        yield from _check_density(body)
        yield from _check_inertia(link, body)
    yield from _check_shapes(link, body)


def _check_density(body: Body) -> Iterator[Finding]:
    if body.density is not None and not _LIGHTEST <= body.density <= _HEAVIEST:
        said = f"{body.mass:.4g} kg over shapes of {body.mass / body.density:.3g} m^3 is {body.density:.3g} kg/m^3"
        yield Finding(Severity.WARNING, body.name, f"{said}: check its mass, or its meshes' scale")


def _check_inertia(link: Link, body: Body) -> Iterator[Finding]:
    box = bounds((*link.collisions, *link.visuals))
    if box is None:
        return
    diagonal = float(np.linalg.norm(box[1] - box[0]))
    center = np.asarray(link.center_of_mass)
    outside = float(np.linalg.norm(np.maximum(np.maximum(box[0] - center, center - box[1]), 0.0)))
    if outside > _OUTSIDE * diagonal:
        yield Finding(
            Severity.WARNING, link.name, f"its centre of mass lies {outside:.3g} m outside its shapes: check the origin"
        )
    farthest = _farthest(box, center)
    most = link.mass * farthest**2
    largest = body.moments[2]
    if largest > most:
        severity = Severity.FAULT if largest > 10.0 * most else Severity.WARNING
        text = (
            f"its largest principal moment, {largest:.3g} kg m^2, is more than {link.mass:.3g} kg within its shapes "
            f"can have ({most:.3g}): check its units and axes"
        )
        yield Finding(severity, link.name, text)
    half = np.sort((box[1] - box[0]) / 2.0)
    least = link.mass * float(half[0] ** 2 + half[1] ** 2) / 3.0
    if body.moments[0] < _TOO_SMALL * least:
        text = f"its least principal moment, {body.moments[0]:.3g} kg m^2, is less than 1/100 of"
        yield Finding(Severity.WARNING, link.name, f"{text} a solid box of its size ({least:.3g}): check its units")


def _check_shapes(link: Link, body: Body) -> Iterator[Finding]:
    collided, seen = bounds(link.collisions), bounds(link.visuals)
    if seen is not None and collided is None:
        yield Finding(Severity.NOTE, link.name, "is seen but collides with nothing")
    if seen is None or collided is None:
        return
    if body.visual_volume > 0 and body.collision_volume > _UNLIKE * body.visual_volume:
        ratio = body.collision_volume / body.visual_volume
        text = f"what collides has {ratio:.1f} times the volume of what is seen: its hull closes hollows"
        yield Finding(Severity.WARNING, link.name, f"{text}; give it convex parts")
    beyond = float(np.maximum(seen[0] - collided[0], collided[1] - seen[1]).max())
    if beyond > (_UNLIKE - 1.0) * float((seen[1] - seen[0]).max()):
        text = f"what collides reaches {beyond:.3g} m beyond what is seen: check its origin and scale"
        yield Finding(Severity.WARNING, link.name, text)


def _farthest(box: FloatArray, point: FloatArray) -> float:
    """From a point to the box's farthest corner."""
    return float(np.linalg.norm(np.maximum(np.abs(box[0] - point), np.abs(box[1] - point))))


def _triple(values: FloatArray) -> tuple[float, float, float]:
    x, y, z = (float(value) for value in values)
    return (x, y, z)
