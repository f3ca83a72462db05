"""Cloth and rope against closed forms, at the solver's default cost: the conformance scenarios of matter."""

from __future__ import annotations

import pytest

from orbit_conformance.scenario import Scenario, Trial
from orbit_conformance.scenarios import SCENARIOS
from orbit_conformance.verdict import Status, run_scenario
from orbit_core.backends import backend


@pytest.mark.parametrize("scenario", [s for s in SCENARIOS if s.of_matter], ids=lambda scenario: scenario.name)
def test_matter_is_as_true_as_the_solver_declares(scenario: Scenario) -> None:
    verdict = run_scenario(scenario, backend("mujoco"), Trial("mujoco", scenario.time_step, matter="orbit-matter"))
    assert verdict.status in (Status.PASS, Status.GAP), f"{verdict.status.value}: {verdict.reason}"
