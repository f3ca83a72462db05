"""Results of several runs as one: what is kept, what is computed again, what is rejected."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Any

import pytest

from orbit_conformance.cli.conformance import main
from orbit_conformance.execution import Outcome
from orbit_conformance.hardware import Hardware
from orbit_conformance.jobs import Job, Kind
from orbit_conformance.journal import Journal
from orbit_conformance.merge import merge
from orbit_conformance.results import Ending, Record, load
from orbit_conformance.runner import header_of
from orbit_conformance.settings import FULL, QUICK, Settings, choose
from orbit_core.interfaces import ConfigurationError, Gap, StorageError
from tests.faults import no_file_beyond

from .conftest import PAIR

ONE, TWO = PAIR
FALL = Job(Kind.SCENARIO, "free_fall", ONE, 0.005)


def settings(backend: str, **changes: Any) -> Settings:
    chosen = choose(backends=(backend,), tasks=("Reach",), scenarios=("free_fall",), parts=("scenarios", "tasks"))
    return dataclasses.replace(chosen, episodes=2, **changes)


def finished(folder: Path, backend: str, *outcomes: Outcome, **changes: Any) -> Path:
    """The folder of a finished run that had these outcomes, with a header changed in these fields."""
    header = dataclasses.replace(header_of(settings(backend)), **changes)
    journal = Journal(folder, header)
    for outcome in outcomes:
        journal.add(outcome)
    journal.finish()
    journal.close()
    return folder


def test_two_backends_runs_on_two_machines_become_one_report(
    tmp_path: Path, finished_run: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    played = {
        record.job.backend: Outcome(record, {name: (finished_run / record.job.key / name).read_bytes()})
        for record in load(finished_run).of(Kind.TASK)
        for name in record.files
    }
    other = Hardware("another", 32, 64.0, ("a GPU",), "system")
    fall = Outcome(Record(FALL, Ending.UNSUPPORTED, "it has no weight"), {"traces.json": b"[]"})
    first = finished(tmp_path / "first", ONE, played[ONE], fall)
    second = finished(tmp_path / "second", TWO, played[TWO], hardware=other)
    output = tmp_path / "merged"
    assert main(["merge", str(first), str(second), "--output", str(output)]) == 0
    result = load(output)
    assert result.header.settings.backends == (ONE, TWO)
    assert {record.job.key for record in result.records} == {
        FALL.key, *(outcome.record.job.key for outcome in played.values())
    }  # fmt: skip
    (parting,) = result.partings
    assert {parting.backend, parting.reference} == {ONE, TWO}, "reckoned from recordings of two runs"
    assert [origin.jobs for origin in result.header.origins] == [
        {f"task on {ONE}": 1, f"scenario on {ONE}": 1}, {f"task on {TWO}": 1}
    ]  # fmt: skip
    page = (output / "report.html").read_text()
    assert "another, 32 cores" in page
    again = merge((output, finished(tmp_path / "third", ONE)), tmp_path / "again")
    assert again.records == result.records
    assert again.partings == result.partings
    with pytest.raises(ConfigurationError, match=f"hold task/Reach/{ONE}: leave one out"):
        merge((output, first), tmp_path / "twice")
    with pytest.raises(ConfigurationError, match="is what is read"):
        merge((first, second), first)


def test_results_of_other_seeds_or_other_declarations_are_refused(tmp_path: Path) -> None:
    first = finished(tmp_path / "first", ONE)
    seeded = finished(tmp_path / "seeded", TWO, settings=settings(TWO, seed=1))
    with pytest.raises(ConfigurationError, match="differ in seed"):
        merge((first, seeded), tmp_path / "out")
    info = header_of(settings(ONE)).backends[0]
    gap = Gap("free_fall", "position", 9.0, "it falls as it likes")
    changed = finished(tmp_path / "changed", ONE, backends=(dataclasses.replace(info, gaps=(gap,)),))
    with pytest.raises(ConfigurationError, match=f"know backend '{ONE}' differently"):
        merge((first, changed), tmp_path / "out")


def test_runs_without_files_are_merged_into_a_new_folder(tmp_path: Path) -> None:
    falls = [
        Outcome(Record(dataclasses.replace(FALL, backend=name), Ending.UNSUPPORTED, "no"), {}) for name in (ONE, TWO)
    ]
    folders = [finished(tmp_path / name, name, fall) for name, fall in zip((ONE, TWO), falls, strict=True)]
    merge(folders, tmp_path / "new" / "merged")
    assert len(load(tmp_path / "new" / "merged").records) == 2


def test_a_result_is_replaced_on_demand_and_nothing_else_is(tmp_path: Path) -> None:
    runs, output = tmp_path / "runs", tmp_path / "merged"
    fall = Outcome(Record(FALL, Ending.UNSUPPORTED, "no"), {"traces.json": b"[]"})
    folders = [finished(runs / ONE, ONE, fall), finished(runs / TWO, TWO)]
    for place, message in ((runs, "holds .*, which is read"), (folders[0] / "inner", "is in .*, which is read")):
        with pytest.raises(ConfigurationError, match=message):
            merge(folders, place, overwrite=True)
    output.mkdir()
    merge(folders, output)
    with pytest.raises(ConfigurationError, match="is there already: give another --output, or --overwrite"):
        merge(folders, output)
    merge(folders, output, overwrite=True)
    (output / "notes.txt").write_text("years")
    with pytest.raises(ConfigurationError, match=r"not only, a result of the suite: it holds notes\.txt"):
        merge(folders, output, overwrite=True)
    (tmp_path / "proj").mkdir()
    (tmp_path / "proj" / "thesis.tex").write_text("years")
    with pytest.raises(ConfigurationError, match=r"it holds no result\.json"):
        merge(folders, tmp_path / "proj", overwrite=True)
    assert [path.name for path in (tmp_path / "proj").iterdir()] == ["thesis.tex"]
    (output / "notes.txt").unlink()
    before = {path: path.read_bytes() for path in output.rglob("*") if path.is_file()}
    with no_file_beyond(1), pytest.raises(StorageError, match="cannot write"):
        merge(folders, output, overwrite=True)
    assert {path: path.read_bytes() for path in output.rglob("*") if path.is_file()} == before


def test_fewer_episodes_are_never_more_and_replay_no_slow_tasks() -> None:
    fewer = settings(ONE).extent
    assert (fewer.episodes, fewer.slow_episodes, fewer.pixel_episodes, fewer.slow_replays) == (2, 2, 2, False)
    many = settings(ONE, quick=True)
    assert dataclasses.replace(many, episodes=99).extent == QUICK
    assert dataclasses.replace(many, quick=False, episodes=99).extent == FULL
