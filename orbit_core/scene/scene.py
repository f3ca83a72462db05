"""One environment's content; a world holds many copies of it."""

from __future__ import annotations

from dataclasses import dataclass

from orbit_core.scene.deformables import Cloth, SoftBody
from orbit_core.scene.entities import Entity, ObjectSpec, RobotSpec
from orbit_core.scene.markers import MarkerSpec
from orbit_core.scene.pose import Vector3
from orbit_core.scene.sensors import SensorSpec
from orbit_core.scene.shapes import Plane, Shape


@dataclass(frozen=True)
class Scene:
    """Robots, objects, terrain and sensors of one environment.

    ``physics_dt`` is the engine's time step in seconds. ``terrain`` are static shapes in the environment's frame.
    """

    robots: tuple[RobotSpec, ...] = ()
    objects: tuple[ObjectSpec, ...] = ()
    deformables: tuple[Cloth | SoftBody, ...] = ()
    terrain: tuple[Shape, ...] = (Shape(Plane(), color=(0.35, 0.38, 0.42, 1.0), name="ground"),)
    sensors: tuple[SensorSpec, ...] = ()
    markers: tuple[MarkerSpec, ...] = ()
    gravity: Vector3 = (0.0, 0.0, -9.81)
    physics_dt: float = 0.005

    @property
    def entities(self) -> tuple[Entity, ...]:
        """Robots, then objects: the order of every entity index."""
        return (*self.robots, *self.objects)
