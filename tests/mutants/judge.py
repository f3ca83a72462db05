"""Runs one test or scenario on the example backend, broken or not."""

from __future__ import annotations

import contextlib
import io
from pathlib import Path
from unittest.mock import patch

import pytest

from orbit_conformance.scenario import Scenario, Trial
from orbit_conformance.scenarios import SCENARIOS
from orbit_conformance.verdict import Status, run_scenario
from orbit_core import backends

from .mutant import Mutant

_BACKEND = "torch"
_TESTS = Path(__file__).parents[1] / "conformance" / "orbit_conformance" / "contract"


def passes(check: str, mutant: Mutant) -> bool:
    """Whether what the mutant breaks passes as it stands, and is not skipped."""
    if "::" not in check:
        return _verdict(_scenario(check), _backend_of(mutant)) in (Status.PASS, Status.GAP)
    return _pytest(check) == pytest.ExitCode.OK


def caught(mutant: Mutant, check: str) -> bool:
    """Whether the test fails, or the scenario's verdict is none that its backend declares."""
    name = "orbit_torch.engine.TorchEngine" if mutant.of_example else "orbit_mujoco.engine.MujocoEngine"
    with patch(name, mutant.engine):
        if "::" not in check:
            return _verdict(_scenario(check), _backend_of(mutant)) in (Status.FAIL, Status.STALE)
        return _pytest(check) == pytest.ExitCode.TESTS_FAILED


def _pytest(check: str) -> int:
    file, _, test = check.partition("::")
    path = _TESTS / f"test_conformance_{file}.py"
    options = ["-x", "-q", "-p", "no:cacheprovider", "--no-header", "-k", f"{_BACKEND}"]
    with contextlib.redirect_stdout(io.StringIO()), contextlib.redirect_stderr(io.StringIO()):
        return pytest.main([f"{path}::{test}", *options])


def _scenario(name: str) -> Scenario:
    return next(scenario for scenario in SCENARIOS if scenario.name == name)


def _backend_of(mutant: Mutant) -> str:
    return _BACKEND if mutant.of_example else "mujoco"


def _verdict(scenario: Scenario, name: str) -> Status:
    backend = backends.backend(name)
    try:
        return run_scenario(scenario, backend, Trial(name, scenario.time_step)).status
    except Exception:  # whatever a broken engine dies of, it is not as declared
        return Status.FAIL
