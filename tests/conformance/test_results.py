"""Uses of a result: its JSON, comparison with another one, loose tolerances."""

from __future__ import annotations

import dataclasses
import math
from pathlib import Path

import pytest

from orbit_conformance.execution import Outcome
from orbit_conformance.hardware import Hardware
from orbit_conformance.jobs import Job, Kind
from orbit_conformance.journal import PREVIOUS, Journal
from orbit_conformance.merge import compare
from orbit_conformance.results import Ending, Header, Record, Result, ScenarioInfo, ScenarioResult, load, save
from orbit_conformance.scenario import Metric
from orbit_conformance.settings import Part, Settings
from orbit_conformance.tolerances import loose_tolerances
from orbit_conformance.verdict import Status
from orbit_core.interfaces import AssetError, ConfigurationError

METRIC = Metric(name="drift", unit="m", tolerance=0.1, meaning="how far")


def result(*records: Record, metric: Metric = METRIC, hardware: str = "a machine") -> Result:
    info = ScenarioInfo("still", "Rest", "Does it rest?", "x = 0", "none", 0.005, (metric,))
    settings = Settings(backends=("one", "two"), scenarios=("still",), tasks=(), parts=(Part.SCENARIOS,))
    header = Header(
        settings=settings,
        versions={},
        hardware=Hardware(hardware, 2, 1.0, (), "system"),
        started="2026-01-01",
        scenarios=(info,),
        backends=(),
    )
    return Result(header=header, records=records, finished="2026-01-02")


def record(error: float, backend: str = "one", status: Status | None = Status.PASS, time_step: float = 0.005) -> Record:
    findings = ScenarioResult(status, "", {"drift": error}, simulated_seconds=1.0, wall_seconds=0.5)
    return Record(Job(Kind.SCENARIO, "still", backend, time_step), Ending.DONE, scenario=findings)


def test_a_result_is_read_as_it_was_written(tmp_path: Path) -> None:
    crashed = Record(Job(Kind.TASK, "Lift", "two"), Ending.CRASH, "it died")
    written = result(
        record(0.1), record(math.inf, "two", Status.FAIL), record(0.2, time_step=1 / 240, status=None), crashed
    )
    save(written, tmp_path)
    assert load(tmp_path) == load(tmp_path / "result.json") == written
    assert [r.job.backend for r in written.objections] == ["two", "two"]


def test_a_finished_run_begins_anew_and_keeps_its_result(tmp_path: Path) -> None:
    header = result().header
    first = Journal(tmp_path, header)
    first.add(Outcome(record(0.1), {"traces.json": b"[]"}))
    finished = first.finish()
    first.close()
    assert (tmp_path / "scenario/still/one/0.005/traces.json").read_bytes() == b"[]"
    again = Journal(tmp_path, header)
    assert not again.records
    again.close()
    assert load(tmp_path / PREVIOUS) == finished
    with pytest.raises(ConfigurationError, match="unfinished run of other versions"):
        Journal(tmp_path, dataclasses.replace(header, versions={"torch": "3"}))


@pytest.mark.parametrize("text", ["", "{}", '{"header": {"schema": 0}}', '{"header": {"schema": 1}}', "[]"])
def test_another_file_is_no_result(tmp_path: Path, text: str) -> None:
    path = tmp_path / "other.json"
    path.write_text(text)
    with pytest.raises(AssetError, match=r"other\.json is"):
        load(path)


@pytest.mark.parametrize(
    ("before", "after", "better"),
    [(0.01, 0.05, False), (0.05, 0.01, True), (math.nan, 0.01, True), (0.01, math.inf, False), (0.01, 0.015, None)],
)
def test_an_error_changes_beyond_a_tenth_of_its_tolerance(before: float, after: float, better: bool | None) -> None:
    changes = compare(result(record(before)), result(record(after))).changes
    assert [change.better for change in changes] == ([] if better is None else [better])


def test_only_a_worse_status_is_worse() -> None:
    passed, failed = result(record(0.01)), result(record(0.5, status=Status.FAIL))
    assert compare(passed, failed).worse_status
    assert not compare(failed, passed).worse_status
    assert not compare(passed, result(record(0.09))).worse_status
    assert not compare(passed, result(record(0.01), record(9.0, time_step=0.01, status=None))).changes


def test_what_cannot_be_compared_is_noted() -> None:
    comparison = compare(result(record(0.01)), result(record(0.01, "two"), hardware="another"))
    assert not comparison.changes
    assert [note.split(":")[0] for note in comparison.notes] == [
        "1 only in the earlier result", "1 only in the later result", "the machines differ",
    ]  # fmt: skip


def test_a_tolerance_over_thrice_the_best_error_needs_a_reason() -> None:
    both = (record(0.02, "one"), record(0.09, "two"))
    (loose,) = loose_tolerances(result(*both))
    assert (loose.best, loose.best_backend) == (0.02, "one")
    excused = dataclasses.replace(METRIC, looser_because="the sensor is coarse")
    assert not loose_tolerances(result(*both, metric=excused))
    assert not loose_tolerances(result(record(0.04), record(0.001, "two", time_step=0.001, status=None)))
