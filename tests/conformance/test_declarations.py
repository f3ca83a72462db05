"""Declarations that cannot be true are found before anything runs, and those that are missed are told with figures."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any, ClassVar

import pytest

from orbit_conformance.report.declared import declarations_of
from orbit_conformance.results import load
from orbit_conformance.scenario import Metric, Scenario, Trial
from orbit_conformance.settings import check_declarations
from orbit_conformance.verdict import Status, judge, run_scenario
from orbit_core import backends
from orbit_core.backends import default_backend
from orbit_core.cli import main
from orbit_core.interfaces import (
    EXACT,
    Backend,
    Capabilities,
    Capability,
    ConfigurationError,
    Engine,
    Gap,
    OrbitError,
    Support,
    approximate,
)

REPORT = Path(__file__).parents[2] / "docs" / "conformance"


class Declaring(Backend):
    """Declares gaps, and simulates nothing."""

    name: ClassVar[str] = "declaring"
    config_type: ClassVar[type] = object

    def __init__(self, *gaps: Gap) -> None:
        self._gaps = gaps
        self.declared: dict[Capability, Support] = {}

    def capabilities(self) -> Capabilities:
        return Capabilities(self.declared)

    def gaps(self) -> tuple[Gap, ...]:
        return self._gaps

    def create_engine(self, *arguments: Any) -> Engine:
        raise NotImplementedError


def test_every_installed_backends_declarations_can_be_true(backend: Backend) -> None:
    check_declarations(backend)


def of_energy(limit: float = 9.0, reason: str = "why", scenario: str = "pendulum", metric: str = "energy") -> Gap:
    return Gap(scenario, metric, limit, reason)


@pytest.mark.parametrize(
    ("gaps", "complaint"),
    [
        ((of_energy(scenario="pendulem"),), "unknown scenario 'pendulem' in the gaps of .* did you mean 'pendulum'"),
        ((of_energy(metric="enrgy"),), "unknown metric 'enrgy' in .*, scenario 'pendulum': did you mean 'energy'"),
        ((of_energy(), of_energy(8.0)), "metric 'energy' of 'pendulum' twice"),
        ((of_energy(0.0),), "'energy' of 'pendulum': the limit must be above the tolerance of .*, not 0"),
        ((of_energy(math.nan),), "'energy' of 'pendulum': the limit must be above the tolerance of .*, not nan"),
        ((of_energy(reason=" "),), "'energy' of 'pendulum': a gap needs a reason"),
    ],
)
def test_a_gap_that_nothing_is_held_against_is_an_error(gaps: tuple[Gap, ...], complaint: str) -> None:
    with pytest.raises(OrbitError, match=complaint):
        check_declarations(Declaring(*gaps))


def test_what_is_declared_exact_is_measured_without_a_gap() -> None:
    backend = Declaring(Gap("joint_friction", "creep", 9.0, "why"))
    backend.declared = {Capability.JOINT_FRICTION: approximate("it creeps")}
    check_declarations(backend)
    backend.declared = {Capability.JOINT_FRICTION: EXACT}
    complaint = "declares 'joint Coulomb friction' exact, and metric 'creep' of 'joint_friction', which measures that"
    with pytest.raises(ConfigurationError, match=complaint):
        check_declarations(backend)


def test_a_gap_of_a_scenario_that_does_not_run_is_an_error() -> None:
    backend = Declaring(Gap("joint_friction", "creep", 9.0, "why"))
    with pytest.raises(ConfigurationError, match="'joint_friction', which does not run on it: no joint"):
        check_declarations(backend)


def test_the_page_of_backends_tells_measures_and_what_is_no_longer_declared(monkeypatch: pytest.MonkeyPatch) -> None:
    """Beside each declared gap stands what the committed report has; without the gap, that measure is told apart."""
    result = load(REPORT)
    name, gap, record = next(
        (info.name, gap, record)
        for info in result.header.backends
        for gap in backends.backend(info.name).gaps()
        if {(old.scenario, old.metric) for old in info.gaps} >= {(gap.scenario, gap.metric)}
        for record in result.scenario_records(gap.scenario, info.name)
        if record.status is Status.GAP
    )
    plugin = backends.backend(name)
    assert record.scenario is not None
    measured = f"{record.scenario.errors[gap.metric]:.2g}"
    page = declarations_of([backends.backend(name)], REPORT)
    (row,) = (line for line in page.splitlines() if line.startswith(f"| {gap.scenario} | {gap.metric} |"))
    assert row.split(" | ")[3] == measured
    assert gap.reason in row
    apart = f"{name} {gap.scenario} {gap.metric} ({measured})"
    assert apart not in page
    kept = tuple(other for other in plugin.gaps() if other != gap)
    monkeypatch.setattr(type(plugin), "gaps", lambda self: kept)
    assert apart in declarations_of([backends.backend(name)], REPORT)


def test_a_run_tells_of_it_before_it_begins(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    real = backends.backend(default_backend())
    monkeypatch.setattr(type(real), "gaps", lambda self: (Gap("free_fal", "path", 9.0, "why"),))
    assert (
        main(["conformance", "--backend", real.name, "--scenario", "free_fall", "--output", str(tmp_path / "o")]) == 2
    )
    assert "did you mean 'free_fall'" in capsys.readouterr().err
    assert not (tmp_path / "o").exists()


def measuring(errors: Mapping[str, float], measured: tuple[float, ...] = ()) -> Scenario:
    """A scenario that comes to these errors, with a curve whose truth is zero."""

    def run(trial: Trial) -> Mapping[str, float]:
        if measured:
            trial.trace("height", "m", [0.1 * index for index in range(len(measured))], measured, [0.0] * len(measured))
        return errors

    metrics = tuple(Metric(name=name, unit="m/s", tolerance=0.1, meaning="how far") for name in errors)
    return Scenario(name="still", group="", question="", truth="", source="", run=run, metrics=metrics)


@pytest.mark.parametrize(
    ("gap", "error", "status", "reason"),
    [
        (None, 0.2, Status.FAIL, "drift is 0.2 m/s, above the tolerance of 0.1 m/s"),
        (0.3, 0.2, Status.GAP, "drift is 0.2 m/s, above the tolerance of 0.1 m/s: why"),
        (0.3, 0.4, Status.FAIL, "drift is 0.4 m/s, beyond the declared 0.3 m/s (the tolerance of 0.1 m/s)"),
        (0.3, 0.05, Status.STALE, "drift is 0.05 m/s, within the tolerance of 0.1 m/s: take the declared gap back"),
        (None, math.nan, Status.FAIL, "drift is nan m/s, above the tolerance of 0.1 m/s"),
        (None, 0.1, Status.PASS, ""),
    ],
)
def test_a_verdict_names_measure_tolerance_and_unit(
    gap: float | None, error: float, status: Status, reason: str
) -> None:
    backend = Declaring(*() if gap is None else (Gap("still", "drift", gap, "why"),))
    verdict = judge(backend, measuring({"drift": error}), {"drift": error})
    assert (verdict.status, verdict.reason) == (status, reason)


@pytest.mark.parametrize(
    ("measured", "where"),
    [
        ((0.0, 0.2, -0.5, 0.1), "; curve 'height' is farthest at 0.2 s: -0.5 m, below 0 m"),
        ((0.0, 0.2, 0.1), "; curve 'height' is farthest at 0.1 s: 0.2 m, above 0 m"),
        ((0.0, math.nan, 0.1), "; curve 'height' is farthest at 0.1 s: nan m, beside 0 m"),
        ((0.0, 0.0), ""),
        ((), ""),
    ],
)
def test_a_failure_names_where_its_curves_are_farthest_from_the_truth(measured: tuple[float, ...], where: str) -> None:
    backend = Declaring()
    verdict = run_scenario(measuring({"drift": 0.2}, measured), backend, Trial(backend.name, 0.005))
    assert verdict.reason == f"drift is 0.2 m/s, above the tolerance of 0.1 m/s{where}"


def test_a_pass_and_a_declared_gap_say_nothing_of_curves() -> None:
    backend = Declaring(Gap("still", "drift", 0.3, "why"))
    verdict = run_scenario(measuring({"drift": 0.2}, (0.0, 1.0)), backend, Trial(backend.name, 0.005))
    assert verdict.reason == "drift is 0.2 m/s, above the tolerance of 0.1 m/s: why"


def test_settings_of_backends_reach_scenarios_and_the_result(tmp_path: Path) -> None:
    """A setting that the backend refuses when its engine is made would be told by the job's record."""
    from orbit_conformance.execution import execute
    from orbit_conformance.jobs import Job, Kind
    from orbit_conformance.settings import choose

    name = default_backend()
    seen: list[Mapping[str, Any]] = []
    settings = choose(backends=(name,), scenarios=("free_fall",), backend_settings={name: _one_setting(name)})
    original = Trial.world

    def world(trial: Trial, *arguments: Any, **keywords: Any) -> Any:
        seen.append(trial.settings)
        return original(trial, *arguments, **keywords)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(Trial, "world", world)
        record = execute(Job(Kind.SCENARIO, "free_fall", name, 0.005), settings, {}).record
    assert record.scenario is not None
    assert seen == [_one_setting(name)] * len(seen) != []


def _one_setting(name: str) -> dict[str, Any]:
    first = dataclasses.fields(backends.backend(name).config_type)[0]
    return {first.name: first.default}


@pytest.mark.parametrize(
    ("words", "complaint"),
    [
        (("--setting", "iterations=3"), "say of which backend the setting 'iterations=3' is"),
        (("--setting", "nothing.iterations=3"), "unknown backend 'nothing'"),
        (("--backend", default_backend(), "--setting", "nothing=3"), "unknown setting 'nothing'"),
    ],
)
def test_a_setting_of_no_backend_is_told(
    words: tuple[str, ...], complaint: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["conformance", *words, "--output", str(tmp_path / "o")]) == 2
    assert complaint in capsys.readouterr().err
