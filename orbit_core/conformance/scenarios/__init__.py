"""All scenarios, in the order in which reports show them."""

from __future__ import annotations

from orbit_core.conformance.scenario import Scenario
from orbit_core.conformance.scenarios import free_motion

SCENARIOS: tuple[Scenario, ...] = (*free_motion.SCENARIOS,)
