"""A published report: a compact page with its data, and everything in an archive whose digest the page names."""

from __future__ import annotations

import dataclasses
import hashlib
import re
import tarfile
from pathlib import Path

import pytest

from orbit_conformance.cli.conformance import main
from orbit_conformance.jobs import Job, Kind
from orbit_conformance.publish import publish
from orbit_conformance.report import plots
from orbit_conformance.results import BackendInfo, Ending, Parting, Record, load, save
from orbit_conformance.verdict import Divergence, Status
from orbit_core.interfaces import AssetError, ConfigurationError, Gap

from .test_results import record, result

REASON = "its solver is soft"
FILM = Job(Kind.VIDEO, "Lift", "one")


def run(folder: Path, finished: str, *records: Record, declares: float = 0.2) -> Path:
    """Write the folder of a finished run, with the file that a film of it has."""
    own = result(*records)
    declared = BackendInfo("one", {"engine": "1"}, (Gap("still", "drift", declares, REASON),))
    header = dataclasses.replace(own.header, backends=(declared,), sources={"core": "0123"})
    curve = Divergence("cube", [0.0, 1.0, 2.0], [0.0] * 3, [0.0, 0.5, 0.1], [1.0] * 3)
    still = dataclasses.replace(curve, thing="table", median=[0.0] * 3)
    partings = (Parting("Lift", "one", "two", [still, curve]),)
    (folder / FILM.key).mkdir(parents=True)
    (folder / FILM.key / "video.mp4").write_bytes(b"a film")
    save(dataclasses.replace(own, header=header, finished=finished, partings=partings), folder)
    return folder


@pytest.fixture(autouse=True)
def no_drawing(monkeypatch: pytest.MonkeyPatch) -> None:
    """Plots are drawn in other tests; one costs a second and more."""
    monkeypatch.setattr(plots, "accuracy", lambda result, info: "<svg></svg>")


@pytest.fixture
def runs(tmp_path: Path) -> list[Path]:
    """An old run, and a newer one that did one job again and declares something else."""
    missed = record(0.15, status=Status.GAP)
    assert missed.scenario is not None
    told = dataclasses.replace(missed.scenario, reason=f"drift is 0.15 m: {REASON}")
    film = Record(FILM, Ending.DONE, files=("video.mp4",))
    old = run(tmp_path / "old", "2026-01-01", record(0.01), record(0.02, "two"), declares=0.3)
    again = (dataclasses.replace(missed, scenario=told), record(0.3, time_step=0.01, status=None), film)
    return [run(tmp_path / "new", "2026-02-03", *again), old]


def test_the_page_keeps_nominal_steps_and_the_archive_all(runs: list[Path], tmp_path: Path) -> None:
    page, archive = tmp_path / "page", tmp_path / "archive"
    assert main(["publish", *map(str, runs), "--output", str(page), "--archive", str(archive)]) == 0
    small = load(page)
    assert small.archive is not None
    content = (archive / small.archive.name).read_bytes()
    assert small.archive.sha256 == hashlib.sha256(content).hexdigest()
    assert small.archive.name == "orbit-conformance-2026-02-03.tar.xz"
    html = (page / "report.html").read_text()
    assert small.archive.name in html
    assert small.archive.sha256 in html
    assert "<svg" not in html
    assert "<video" not in html
    assert {(r.job.backend, r.job.time_step) for r in small.of(Kind.SCENARIO)} == {("one", 0.005), ("two", 0.005)}
    (judged,) = (r for r in small.of(Kind.SCENARIO) if r.job.backend == "one")
    assert judged.status is Status.GAP, "the later of two runs of one job counts"
    assert judged.why == "drift is 0.15 m", "the declaration has the reason"
    assert [gap.limit for gap in small.header.backends[0].gaps] == [0.2]
    assert small.partings[0].things == [Divergence("cube", [1.0], [0.0], [0.5], [1.0])]

    with tarfile.open(archive / small.archive.name) as packed:
        packed.extractall(tmp_path / "unpacked", filter="data")
    (whole,) = (tmp_path / "unpacked").iterdir()
    assert len(load(whole).of(Kind.SCENARIO)) == 3
    assert (whole / FILM.key / "video.mp4").read_bytes() == b"a film"
    assert "<svg" in (whole / "report.html").read_text()


def test_an_archive_is_the_same_byte_by_byte_and_is_published_again(runs: list[Path], tmp_path: Path) -> None:
    first = publish(runs, tmp_path / "page", tmp_path / "archive").archive
    assert publish(runs, tmp_path / "page", tmp_path / "again").archive == first
    assert first is not None
    with tarfile.open(tmp_path / "archive" / first.name) as packed:
        packed.extractall(tmp_path / "unpacked", filter="data")
    (whole,) = (tmp_path / "unpacked").iterdir()
    assert publish([whole], tmp_path / "page", tmp_path / "third").archive == first


def test_a_condensed_result_is_no_whole_one(runs: list[Path], tmp_path: Path) -> None:
    publish(runs, tmp_path / "page", tmp_path / "archive")
    with pytest.raises(ConfigurationError, match=r"condensed result: unpack orbit-conformance-2026-02-03\.tar\.xz"):
        publish([tmp_path / "page"], tmp_path / "other", tmp_path / "archive")
    with pytest.raises(ConfigurationError):
        publish(runs, runs[0], tmp_path / "archive")


def test_rates_that_were_measured_elsewhere_come_with_their_hardware(runs: list[Path], tmp_path: Path) -> None:
    rates = tmp_path / "rates.json"
    rates.write_text(
        '[{"task": "Lift", "action": "a", "backend": "one", "num_envs": 4096, "env_steps_per_second": 12345,'
        ' "ratio": 0.9, "hardware": "A GPU", "command": "python bench.py"}]'
    )
    small = publish(runs, tmp_path / "page", tmp_path / "archive", rates)
    assert [rate.env_steps_per_second for rate in small.benchmarks] == [12345]
    row = re.search(r"<tr><td>Lift</td>.*</tr>", (tmp_path / "page" / "report.html").read_text())
    assert row is not None
    assert "12,345" in row[0]
    assert "A GPU" in row[0]
    rates.write_text('[{"task": "Lift"}]')
    with pytest.raises(AssetError, match="no list of benchmarks"):
        publish(runs, tmp_path / "page", tmp_path / "archive", rates)
