"""The real command in a process of its own: an engine that dies costs its job alone, and a killed run goes on."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import time
from pathlib import Path

import psutil
import pytest

from orbit_conformance.journal import JOURNAL
from orbit_conformance.results import Ending, load
from orbit_conformance.verdict import Status
from orbit_core.cli import main

from .conftest import PAIR, PROGRAM

BACKEND = PAIR[0]


def conformance(*words: str) -> subprocess.CompletedProcess[str]:
    environment = {**os.environ, "OMP_NUM_THREADS": "1"}
    return subprocess.run([*PROGRAM, *words], capture_output=True, text=True, timeout=600, env=environment)


def test_an_engine_that_dies_or_hangs_fails_alone(broken_run: Path) -> None:
    records = {record.job.backend: record for record in load(broken_run).records}
    assert records["dying"].ending is Ending.CRASH
    assert "SIGABRT" in records["dying"].reason
    assert "create_engine" in (broken_run / "log.txt").read_text(), "the log tells where it died"
    assert records["hanging"].ending is Ending.TIMEOUT
    assert records[BACKEND].status is Status.PASS
    told = " ".join((broken_run / "told").read_text().split())
    assert "scenario/projectile/dying/0.005: fail: its process died of SIGABRT" in told


def test_a_killed_run_goes_on_where_it_was(tmp_path: Path) -> None:
    words = ("--scenario", "free_fall", "projectile", "--backend", BACKEND, "--jobs", "1", "--output", str(tmp_path))
    journal = tmp_path / JOURNAL
    running = subprocess.Popen([*PROGRAM, *words], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    _until(lambda: journal.exists() and journal.read_text().count("\n") >= 3)
    workers = psutil.Process(running.pid).children(recursive=True)
    running.send_signal(signal.SIGKILL)
    running.wait()
    _until(lambda: not any(worker.is_running() for worker in workers))
    kept = [json.loads(line) for line in journal.read_text().splitlines()[1:]]
    with journal.open("a") as file:
        file.write('{"job": {"kind": "scen')  # as a kill in the midst of a line leaves it

    refused = conformance(*words[:1], "free_fall", *words[3:])
    assert refused.returncode == 2
    assert "unfinished run of other settings" in refused.stderr

    done = conformance(*words)
    assert done.returncode in (0, 1), done.stderr
    result = load(tmp_path)
    assert len({record.job.key for record in result.records}) == len(result.records) == 8
    seconds = {(r.job.name, r.job.time_step): r.seconds for r in result.records}
    assert all(seconds[one["job"]["name"], one["job"]["time_step"]] == one["seconds"] for one in kept)
    assert not journal.exists()


def test_a_ray_cluster_does_the_jobs_and_one_that_is_gone_is_told(tmp_path: Path) -> None:
    pytest.importorskip("ray", reason="capability 'ray' is not installed: pip install 'orbit-conformance[ray]'")
    words = ("--scenario", "free_fall", "--quick", "--backend", BACKEND, "--output", str(tmp_path), "--ray")
    gone = conformance(*words, "127.0.0.1:1")
    assert (gone.returncode, "no Ray cluster answers at '127.0.0.1:1'" in gone.stderr) == (2, True)
    done = conformance(*words, "local")
    assert done.returncode == 0, done.stderr
    (record,) = load(tmp_path).records
    assert record.status is Status.PASS


def _until(condition: object, seconds: float = 120.0) -> None:
    end = time.monotonic() + seconds
    while not condition():  # type: ignore[operator]
        assert time.monotonic() < end, "it did not come about in time"
        time.sleep(0.1)


@pytest.mark.parametrize(
    ("words", "complaint"),
    [
        (("--scenario", "freefall"), "did you mean 'free_fall'"),
        (("--part", "task"), "did you mean 'tasks'"),
        (("--backend", f"{BACKEND}x"), f"did you mean '{BACKEND}'"),
        (("--jobs", "0"), "jobs must be at least 1"),
        (("report", "/nowhere"), "cannot read /nowhere"),
    ],
)
def test_mistakes_are_told_in_one_line(
    words: tuple[str, ...], complaint: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    code = main(["conformance", *words, *(() if words[0] == "report" else ("--output", str(tmp_path / "out")))])
    assert code == 2
    told = capsys.readouterr().err
    assert complaint in told
    assert len(told.splitlines()) == 1
