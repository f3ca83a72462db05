"""All scenarios, in the order in which reports show them."""

from __future__ import annotations

from orbit_core.conformance.scenario import Scenario
from orbit_core.conformance.scenarios import (
    as_described,
    contact_forces,
    dominoes,
    drives,
    free_motion,
    friction,
    grasp,
    gyroscopes,
    images,
    impact,
    joints,
    linkages,
    parameters,
    pendula,
    rays,
    repeatability,
    resting,
    rolling,
    sensing,
    stacks,
    turning_friction,
    velocities,
)

SCENARIOS: tuple[Scenario, ...] = (
    *free_motion.SCENARIOS,
    *pendula.SCENARIOS,
    *gyroscopes.SCENARIOS,
    *joints.SCENARIOS,
    *drives.SCENARIOS,
    *linkages.SCENARIOS,
    *as_described.SCENARIOS,
    *friction.SCENARIOS,
    *turning_friction.SCENARIOS,
    *rolling.SCENARIOS,
    *impact.SCENARIOS,
    *dominoes.SCENARIOS,
    *resting.SCENARIOS,
    *stacks.SCENARIOS,
    *velocities.SCENARIOS,
    *grasp.SCENARIOS,
    *contact_forces.SCENARIOS,
    *sensing.SCENARIOS,
    *rays.SCENARIOS,
    *images.SCENARIOS,
    *parameters.SCENARIOS,
    *repeatability.SCENARIOS,
)
