"""Verdicts from errors."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace
from unittest.mock import patch

import pytest

from orbit_conformance.scenario import Trial
from orbit_conformance.scenarios import SCENARIOS
from orbit_conformance.verdict import Status, Verdict, run_scenario
from orbit_core import backends
from orbit_core.interfaces import Gap, SimulationError


def _verdict_of_a_diverging_run(limits: Mapping[str, float]) -> Verdict:
    def diverge(trial: Trial) -> Mapping[str, float]:
        raise SimulationError("environment 0 diverged")

    scenario = replace(SCENARIOS[0], run=diverge)
    backend = backends.backend(backends.backend_names()[0])
    gaps = tuple(Gap(scenario.name, metric, limit, "too fast for it") for metric, limit in limits.items())
    with patch.object(type(backend), "gaps", lambda _: gaps):
        return run_scenario(scenario, backend, Trial(backend.name, scenario.time_step))


@pytest.mark.parametrize(
    ("limit", "status"), [(1e9, Status.FAIL), (math.inf, Status.GAP)], ids=["finite limit", "infinite limit"]
)
def test_a_run_that_diverges_is_declared_by_an_infinite_limit_alone(limit: float, status: Status) -> None:
    verdict = _verdict_of_a_diverging_run({metric.name: limit for metric in SCENARIOS[0].metrics})
    assert verdict.status is status
    assert "environment 0 diverged" in verdict.reason
