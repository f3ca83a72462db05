"""Observation terms of rays, each with the sensor that casts them."""

from __future__ import annotations

from typing import cast

from torch import Tensor

from orbit_core.envs.environment import Environment
from orbit_core.envs.terms import Meaning, ObservationTerm
from orbit_core.scene import RayCasterSpec
from orbit_core.sensors.rays import RayCaster


def height_scan(rays: RayCasterSpec) -> ObservationTerm:
    """(N, R) metres along each ray to what it hits; ``rays.max_distance`` where it hits nothing."""

    def distances(env: Environment) -> Tensor:
        return cast(RayCaster, env.world.sensors[rays.name]).distances.clamp(0.0, rays.max_distance)

    cast_from = [f"ray from ({x:g}, {y:g}, {z:g})" for x, y, z in rays.origins]
    formula = f"distance along each ray of '{rays.name}' to what it hits, {rays.max_distance:g} where it hits nothing"
    frame = "sensor: origins of the rays in its axes" + (", turned by the yaw of its link alone" * rays.yaw_only)
    meaning = Meaning(formula, frame, tuple(cast_from))
    return ObservationTerm(distances, sensors=(rays,), bounds=(0.0, rays.max_distance), unit="m", meaning=meaning)
