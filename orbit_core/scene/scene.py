"""The content of one environment, its lights and its markers; a world holds many copies of it.

Every renderer shades alike. The colour of a pixel, each of red, green and blue by itself, is

    clip(albedo * (ambient + sum over k of reached_k * intensity_k * color_k * max(0, n . (-direction_k))), 0, 1)

with the shape's own colour ``albedo``, the sum ``ambient`` of all ambient lights, the surface's unit normal ``n`` and
``reached_k``, 0 where the directional light k casts shadows and something opaque is between it and the surface, or
else 1. It is Lambert's law, computed in the numbers of the picture (sRGB, as they are stored) with no conversion to
linear light: half the light is half the number.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from enum import Enum

from orbit_core.scene.deformables import DeformableSpec
from orbit_core.scene.entities import Entity, ObjectSpec, RobotSpec
from orbit_core.scene.pose import Vector3
from orbit_core.scene.sensors import SensorSpec
from orbit_core.scene.shapes import Color, Plane, Shape

Rgb = tuple[float, float, float]
"""Red, green and blue."""

MAX_DIRECTIONAL_LIGHTS = 3
"""Most directional lights of one scene, which every renderer can draw."""


@dataclass(frozen=True)
class AmbientLight:
    """Light that reaches every surface alike, from all around."""

    color: Rgb = (0.42, 0.42, 0.45)
    """Linear RGB; a surface's colour is multiplied by it."""


@dataclass(frozen=True)
class DirectionalLight:
    """Parallel light, as the sun's.

    ``direction`` is where the light travels to, in the environment's frame and of any length but zero. A surface that
    faces the light gains ``intensity * color``.
    """

    direction: Vector3 = (-0.35, 0.45, -1.0)
    color: Rgb = (1.0, 0.97, 0.92)
    """Linear RGB, in proportion."""
    intensity: float = 0.58
    """Factor of ``color``."""
    shadows: bool = True
    """True if things in its way darken what is behind them."""

    @property
    def unit_direction(self) -> Vector3:
        """The direction, of length 1."""
        # Normalised here and not at construction, so that files keep the numbers that a user wrote.
        length = math.hypot(*self.direction)
        x, y, z = self.direction
        return (x / length, y / length, z / length)

    @property
    def radiance(self) -> Rgb:
        """Intensity times colour."""
        red, green, blue = self.color
        return (self.intensity * red, self.intensity * green, self.intensity * blue)


Light = AmbientLight | DirectionalLight


@dataclass(frozen=True)
class Sky:
    """Background of pictures; lights do not affect it.

    Colours straight above and straight below; between them the part of ``above`` is ``(1 + z) / 2``, where ``z`` is the
    height of the unit vector along the pixel's ray.
    """

    above: Rgb = (0.55, 0.68, 0.82)
    below: Rgb = (0.88, 0.91, 0.94)
    """Colour straight below."""


class MarkerShape(Enum):
    """Appearance of a marker."""

    FRAME = "frame"
    """Three axes: x red, y green, z blue."""
    SPHERE = "sphere"
    """Ball, of ``size`` as diameter."""
    BOX = "box"
    """Cube, of ``size`` as edge."""
    ARROW = "arrow"
    """Along the marker's x axis."""


@dataclass(frozen=True)
class MarkerSpec:
    """A marker in each environment; its pose is set at run time. ``size`` is its length in metres."""

    name: str
    """Unique among the scene's markers."""
    shape: MarkerShape = MarkerShape.FRAME
    """Appearance."""
    size: float = 0.1
    color: Color = (0.1, 0.8, 0.1, 0.6)
    """RGBA in [0, 1]; axes of a frame keep their own colours."""
    shapes: tuple[Shape, ...] = ()
    """More shapes to draw; with a ``size`` of zero they are all. :func:`ghost` makes some."""


def ghost(name: str, entity: Entity, axes: float = 0.0, opacity: float = 0.4) -> MarkerSpec:
    """Return a marker that looks like the root link of an entity, seen through: the pose that it shall reach.

    Args:
        name: of the marker.
        entity: whose root link is drawn.
        axes: metres of the axes that are drawn with it; zero draws none.
        opacity: of the link's shapes.
    """
    root = entity.articulation.root
    shapes = (replace(shape, color=(*shape.color[:3], opacity)) for shape in root.visuals or root.collisions)
    return MarkerSpec(name, size=axes, color=(0.0, 0.0, 0.0, 1.0), shapes=tuple(shapes))


@dataclass(frozen=True)
class Scene:
    """Robots, objects, terrain, sensors and light of one environment.

    ``physics_dt`` is the engine's time step in seconds. ``terrain`` are static shapes in the environment's frame.
    ``lights`` and ``sky`` are what colour images are shaded with (:mod:`orbit_core.scene.scene`). With
    ``firm_friction`` friction shall hold what stands still for long, such as a robot on its feet: an engine whose own
    is soft makes it firmer, at a cost of speed, unless its settings say how firm; others have nothing to do.
    """

    robots: tuple[RobotSpec, ...] = ()
    """Articulations with actuators, which actions may move."""
    objects: tuple[ObjectSpec, ...] = ()
    """All other things that move, or are fixed with joints."""
    deformables: tuple[DeformableSpec, ...] = ()
    """Cloth, ropes, soft bodies and liquids."""
    # Ground by default: a scene without any lets everything fall forever, which is seldom meant.
    terrain: tuple[Shape, ...] = (Shape(Plane(), color=(0.35, 0.38, 0.42, 1.0), name="ground"),)
    sensors: tuple[SensorSpec, ...] = ()
    """Measurements; a sensor that nobody reads costs nothing unless it has a rate."""
    markers: tuple[MarkerSpec, ...] = ()
    """Things drawn for people, without physics."""
    # One shadow-casting light by default: renderers must not invent lights, or pictures would differ.
    lights: tuple[Light, ...] = (AmbientLight(), DirectionalLight())
    sky: Sky = field(default_factory=Sky)
    gravity: Vector3 = (0.0, 0.0, -9.81)
    """m/s^2, in the environment's frame."""
    physics_dt: float = 0.005
    firm_friction: bool = False

    @property
    def entities(self) -> tuple[Entity, ...]:
        """Robots, then objects: the order of every entity index."""
        return (*self.robots, *self.objects)

    @property
    def ambient(self) -> Rgb:
        """The sum of all ambient lights."""
        # Ambient lights add up; renderers take one sum.
        colors = [light.color for light in self.lights if isinstance(light, AmbientLight)]
        return (sum(c[0] for c in colors), sum(c[1] for c in colors), sum(c[2] for c in colors))

    @property
    def directional_lights(self) -> tuple[DirectionalLight, ...]:
        """All lights that have a direction, in the scene's order."""
        return tuple(light for light in self.lights if isinstance(light, DirectionalLight))
