"""Library of household things: made by script from a table of sizes and masses, with hulls, labels and grasps."""

from __future__ import annotations

import functools
import math
from dataclasses import dataclass, field, replace
from importlib.resources import as_file, files
from typing import Any, ClassVar

import numpy as np

from orbit_assets.mass_properties import shapes_mass_properties
from orbit_core.configuration import from_plain, read_toml
from orbit_core.interfaces.errors import ConfigurationError, UnknownNameError
from orbit_core.objects import ObjectConfig
from orbit_core.plugin_kit.meshes import triangles
from orbit_core.scene import Articulation, Color, Link, ObjectSpec, PhysicsMaterial, Pose, Shape
from orbit_core.scene.pose import FloatArray, Vector3
from orbit_scenes.forms import (
    Cavity,
    Form,
    Part,
    Piece,
    Vessel,
    assembled,
    block,
    can,
    rounded,
    turned,
    vessel,
)

_FORMS = ("block", "can", "round", "turned", "vessel", "parts")


@dataclass(frozen=True, kw_only=True)
class ThingData:
    """One entry of the table ``data/things.toml``: a form, a mass and a surface.

    Raises:
        ConfigurationError: it has no form or two, or no mass.
    """

    mass: float
    """kg"""
    source: str
    """Source of size and mass; see the head of the table."""
    color: tuple[float, ...]
    """RGB or RGBA, 0 to 1."""
    friction: float = 0.6
    """Coefficient of static and dynamic friction, an estimate for all things."""
    label: str = ""
    """Semantic label; the thing's name where it is left out."""
    block: tuple[float, ...] = ()
    """Full size of a box, m."""
    can: tuple[float, ...] = ()
    """Diameter and height of an upright cylinder, m."""
    round: tuple[float, ...] = ()
    """Full size of an ellipsoid, m."""
    turned: tuple[tuple[float, ...], ...] = ()
    """Rows of [radius, height] of a solid turned about z, from the bottom up, m."""
    vessel: Vessel | None = None
    """Profile, walls and handles of what is open at the top."""
    parts: tuple[Part, ...] = ()
    """Convex parts, in the pose in which the thing rests."""

    def __post_init__(self) -> None:
        given = [name for name in _FORMS if getattr(self, name)]
        if len(given) != 1:
            raise ConfigurationError(f"it has {' and '.join(given) or 'no form'}: give one of {', '.join(_FORMS)}")
        if not 0.0 < self.mass < math.inf:
            raise ConfigurationError(f"its mass is {self.mass} kg: give one above zero")

    def form(self) -> Form:
        """Build its pieces and surfaces, the lowest point at z = 0."""
        if self.block:
            return block(self.block)
        if self.can:
            return can(*self.can)
        if self.round:
            return rounded(self.round)
        if self.turned:
            return turned(self.turned)
        if self.vessel is not None:
            return vessel(self.vessel)
        return assembled(self.parts)


@dataclass(frozen=True, eq=False)
class Thing:
    """A household thing as one rigid body; its frame is the middle of its bounding box, upright as it rests."""

    name: str
    """Name in the library."""
    articulation: Articulation
    """One link without joints."""
    size: Vector3
    """Full size of its bounding box, m."""
    source: str
    """Source of size and mass; see the head of the table."""
    cavity: Cavity | None = None
    """Space inside of it; its axis is in the thing's frame, and heights are from the thing's underside."""

    @property
    def rest_height(self) -> float:
        """Height of its frame above what it rests on, m."""
        return self.size[2] / 2.0

    @property
    def link(self) -> Link:
        """The only link."""
        return self.articulation.root

    def build(self, name: str, pose: Pose | None = None) -> ObjectSpec:
        """Build the object; ``pose`` is of its frame, by default resting on z = 0."""
        return ObjectSpec(
            name=name,
            articulation=self.articulation,
            pose=pose or Pose((0.0, 0.0, self.rest_height)),
            semantic_label=self.link.semantic_label,
        )


@functools.cache
def thing_table() -> dict[str, ThingData]:
    """Return the table of things by name, as the file states it.

    Raises:
        ConfigurationError: the file has an entry that describes no thing.
    """
    with as_file(files("orbit_scenes") / "data" / "things.toml") as path:
        values = read_toml(path, "table of things")
    return {name: from_plain(ThingData, entry, f"thing '{name}'") for name, entry in values.items()}


def thing_names() -> list[str]:
    """Return the names of all things of the library."""
    return list(thing_table())


@functools.cache
def thing(name: str) -> Thing:
    """Return a thing of the library.

    Raises:
        UnknownNameError: there is none of that name.
    """
    data = thing_table().get(name)
    if data is None:
        raise UnknownNameError("thing", name, thing_names(), "the library of things")
    return make_thing(name, data)


def make_thing(name: str, data: ThingData) -> Thing:
    """Build a thing from its entry of a table, its mass spread evenly over its collision pieces.

    Raises:
        ConfigurationError: its numbers describe no solid.
    """
    form = data.form()
    # What is drawn is round where collision pieces have corners: its size is the true one.
    low, high = _bounds(form.visuals)
    middle = Pose(tuple((low + high) / 2.0)).inverse()
    material = PhysicsMaterial(data.friction, data.friction)
    color = _color(data.color)

    def shapes(pieces: tuple[Piece, ...], kind: str) -> tuple[Shape, ...]:
        return tuple(
            Shape(
                piece.geometry,
                middle @ piece.pose,
                material,
                color if piece.color is None else _color(piece.color),
                f"{kind}_{index}",
            )
            for index, piece in enumerate(pieces)
        )

    collisions = shapes(form.collisions, "piece")
    # Solids of one piece are drawn as they collide: the same shape is then held once.
    same = form.visuals == form.collisions
    visuals = collisions if same else shapes(form.visuals, "visual")
    # Mass is proportional to density: one computation at density 1 gives the density of the right mass.
    solid = shapes_mass_properties(collisions, 1.0)
    solid = shapes_mass_properties(collisions, data.mass / solid.mass)
    link = Link(name, solid.mass, solid.center_of_mass, solid.inertia, collisions, visuals, data.label or name)
    x, y, z = (float(value) for value in high - low)
    # Heights stay those above the underside, which do not depend on where the frame is.
    cavity = form.cavity and replace(form.cavity, axis=(middle.position[0], middle.position[1]))
    return Thing(name, Articulation(name, (link,)), (x, y, z), data.source, cavity)


def _bounds(pieces: tuple[Piece, ...]) -> tuple[FloatArray, FloatArray]:
    corners = [piece.pose.transform(triangles(piece.geometry).vertices) for piece in pieces]
    points = np.concatenate(corners)
    return points.min(0), points.max(0)


def _color(values: tuple[float, ...]) -> Color:
    r, g, b, a = (*values, 1.0)[:4]
    return (r, g, b, a)


@dataclass(frozen=True, kw_only=True)
class ThingConfig(ObjectConfig):
    """A thing of the household library, chosen by name: ``--set cube=thing --set cube.thing=mug``."""

    name: ClassVar[str] = "thing"
    thing: str = "mug"
    """Name in the library; ``orbit scene things`` lists all."""
    mass: float | None = None
    """kg; None takes the library's."""
    material: PhysicsMaterial | None = field(default=None)
    """None takes the library's friction."""

    def build(self, name: str, pose: Pose | None = None) -> ObjectSpec:
        return replace(self._thing.build(name, pose), articulation=self._edited())

    @property
    def rest_height(self) -> float:
        return self._thing.rest_height

    @property
    def _thing(self) -> Thing:
        return thing(self.thing)

    def _edited(self) -> Articulation:
        link = self._thing.link
        changes: dict[str, Any] = {}
        if self.mass is not None:
            changes |= {"mass": self.mass, "inertia": link.inertia * (self.mass / link.mass)}
        if self.material is not None:
            changes["collisions"] = tuple(replace(shape, material=self.material) for shape in link.collisions)
        return replace(self._thing.articulation, links=(replace(link, **changes),))
