"""Every scenario x every installed backend: passed, missed as declared, or skipped for a declared reason."""

from __future__ import annotations

import pytest

from orbit_conformance.scenario import Scenario, Trial
from orbit_conformance.scenarios import SCENARIOS
from orbit_conformance.verdict import Status, run_scenario
from orbit_core.backends import matter_names
from orbit_core.interfaces import Backend
from orbit_core.interfaces.matter import NATIVE

MATTERS = (*matter_names(), NATIVE)
RUNS = [(s, matter) for s in SCENARIOS if not s.slow for matter in (MATTERS if s.of_matter else (NATIVE,))]


@pytest.mark.parametrize(
    ("scenario", "matter"), RUNS, ids=[f"{s.name}-{matter}" if s.of_matter else s.name for s, matter in RUNS]
)
def test_a_backend_is_as_it_declares(
    backend: Backend, scenario: Scenario, matter: str, request: pytest.FixtureRequest
) -> None:
    device = str(request.config.getoption("--device", "cpu"))
    verdict = run_scenario(scenario, backend, Trial(backend.name, scenario.time_step, device, matter=matter))
    if verdict.status is Status.UNSUPPORTED:
        pytest.skip(f"{backend.name}: {verdict.reason}")
    assert verdict.status.acceptable, f"{verdict.status.value}: {verdict.reason}"
