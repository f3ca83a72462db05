"""All scenarios, in the order in which reports show them."""

from __future__ import annotations

from orbit_core.conformance.scenario import Scenario
from orbit_core.conformance.scenarios import (
    drives,
    free_motion,
    joints,
    linkages,
    parameters,
    pendula,
    rays,
    repeatability,
    sensing,
)

SCENARIOS: tuple[Scenario, ...] = (
    *free_motion.SCENARIOS,
    *pendula.SCENARIOS,
    *joints.SCENARIOS,
    *drives.SCENARIOS,
    *linkages.SCENARIOS,
    *sensing.SCENARIOS,
    *rays.SCENARIOS,
    *parameters.SCENARIOS,
    *repeatability.SCENARIOS,
)
