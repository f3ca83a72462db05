"""One environment's content; a world holds many copies of it."""

from __future__ import annotations

from dataclasses import dataclass, field

from orbit_core.scene.deformables import DeformableSpec
from orbit_core.scene.entities import Entity, ObjectSpec, RobotSpec
from orbit_core.scene.lights import AmbientLight, DirectionalLight, Light, Rgb, Sky
from orbit_core.scene.markers import MarkerSpec
from orbit_core.scene.pose import Vector3
from orbit_core.scene.sensors import SensorSpec
from orbit_core.scene.shapes import Plane, Shape


@dataclass(frozen=True)
class Scene:
    """Robots, objects, terrain, sensors and light of one environment.

    ``physics_dt`` is the engine's time step in seconds. ``terrain`` are static shapes in the environment's frame.
    ``lights`` and ``sky`` are what colour images are shaded with (:mod:`orbit_core.scene.lights`). With
    ``firm_friction`` friction shall hold what stands still for long, such as a robot on its feet: an engine whose own
    is soft makes it firmer, at a cost of speed, unless its settings say how firm; others have nothing to do.
    """

    robots: tuple[RobotSpec, ...] = ()
    objects: tuple[ObjectSpec, ...] = ()
    deformables: tuple[DeformableSpec, ...] = ()
    terrain: tuple[Shape, ...] = (Shape(Plane(), color=(0.35, 0.38, 0.42, 1.0), name="ground"),)
    sensors: tuple[SensorSpec, ...] = ()
    markers: tuple[MarkerSpec, ...] = ()
    lights: tuple[Light, ...] = (AmbientLight(), DirectionalLight())
    sky: Sky = field(default_factory=Sky)
    gravity: Vector3 = (0.0, 0.0, -9.81)
    physics_dt: float = 0.005
    firm_friction: bool = False

    @property
    def entities(self) -> tuple[Entity, ...]:
        """Robots, then objects: the order of every entity index."""
        return (*self.robots, *self.objects)

    @property
    def ambient(self) -> Rgb:
        """The sum of all ambient lights."""
        colors = [light.color for light in self.lights if isinstance(light, AmbientLight)]
        return (sum(c[0] for c in colors), sum(c[1] for c in colors), sum(c[2] for c in colors))

    @property
    def directional_lights(self) -> tuple[DirectionalLight, ...]:
        """All lights that have a direction, in the scene's order."""
        return tuple(light for light in self.lights if isinstance(light, DirectionalLight))
