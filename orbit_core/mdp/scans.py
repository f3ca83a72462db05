"""Observation terms of rays, each with the sensor that casts them."""

from __future__ import annotations

from typing import cast

from torch import Tensor

from orbit_core.envs.task import Task
from orbit_core.envs.terms import ObservationTerm
from orbit_core.interfaces import World
from orbit_core.scene import RayCasterSpec
from orbit_core.sensors.rays import RayCaster


def height_scan(rays: RayCasterSpec) -> ObservationTerm:
    """(N, R) metres along each ray to what it hits; ``rays.max_distance`` where it hits nothing."""

    def distances(world: World, task: Task) -> Tensor:
        return cast(RayCaster, world.sensors[rays.name]).distances.clamp(0.0, rays.max_distance)

    return ObservationTerm(distances, sensors=(rays,), bounds=(0.0, rays.max_distance), unit="m")
