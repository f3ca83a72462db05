"""The folder of a run: what it goes on with, what is done again, who may write, and what a full disk leaves."""

from __future__ import annotations

import dataclasses
import errno
import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

from orbit_conformance import execution
from orbit_conformance.execution import Outcome
from orbit_conformance.jobs import Job, Kind, plan
from orbit_conformance.journal import DROPPED, JOURNAL, Journal
from orbit_conformance.results import RESULT_FILE, Ending, Header, Record, load
from orbit_conformance.runner import header_of
from orbit_conformance.settings import choose
from orbit_conformance.sources import CORE, backend_packages, source_digests, sources_of
from orbit_core.backends import backend_names
from orbit_core.interfaces import ConfigurationError, StorageError
from tests.faults import no_file_beyond
from tests.forked import run_forked

ONE, TWO = backend_names()[:2]
SETTINGS = choose(backends=(ONE, TWO), tasks=("Reach",), scenarios=("free_fall",), parts=("scenarios", "tasks"))
FALL = {name: Job(Kind.SCENARIO, "free_fall", name, 0.005) for name in (ONE, TWO)}
REACH = {name: Job(Kind.TASK, "Reach", name) for name in (ONE, TWO)}
REPLAY = Job(Kind.REPLAY, "Reach", ONE, source=TWO)
"""On one backend of what the other recorded."""
ALL = {*FALL.values(), *REACH.values(), REPLAY}


@pytest.fixture(scope="module")
def header() -> Header:
    return header_of(SETTINGS)


@pytest.fixture
def unfinished(tmp_path: Path, header: Header) -> Path:
    """The folder of a run that was stopped after five jobs."""
    journal = Journal(tmp_path, header)
    for job in ALL:
        journal.add(Outcome(Record(job, Ending.DONE)))
    journal.close()
    return tmp_path


def changed(header: Header, *names: str) -> Header:
    """The header of a run with other source of these."""
    assert {*names} <= {*header.sources}
    return dataclasses.replace(header, sources=header.sources | dict.fromkeys(names, "other"))


def resumed(folder: Path, header: Header, fresh: bool = False) -> tuple[set[Job], str]:
    journal = Journal(folder, header, fresh)
    journal.close()
    return {record.job for record in journal.records.values()}, journal.dropped


def test_an_unfinished_run_goes_on(unfinished: Path, header: Header) -> None:
    assert resumed(unfinished, header) == (ALL, "")


def test_fresh_begins_anew_and_keeps_the_journal(unfinished: Path, header: Header) -> None:
    before = (unfinished / JOURNAL).read_bytes()
    assert resumed(unfinished, header, fresh=True) == (set(), "")
    assert (unfinished / DROPPED).read_bytes() == before


@pytest.mark.parametrize("finished", [True, False])
def test_a_run_that_cannot_begin_leaves_the_one_that_was_there(
    finished: bool, unfinished: Path, header: Header
) -> None:
    if finished:
        journal = Journal(unfinished, header)
        journal.finish()
        journal.close()
    before = {path: path.read_bytes() for path in unfinished.iterdir() if path.name != ".lock"}
    with no_file_beyond(100), pytest.raises(StorageError, match="File too large"):
        Journal(unfinished, header, fresh=True)
    assert {path: path.read_bytes() for path in unfinished.iterdir() if path.name != ".lock"} == before


def test_a_folder_of_other_things_takes_no_run(tmp_path: Path, header: Header) -> None:
    (tmp_path / "report.html").write_text("my own")
    with pytest.raises(ConfigurationError, match="holds other things and no run of this suite"):
        Journal(tmp_path, header)
    assert [path.name for path in tmp_path.iterdir()] == ["report.html"]


def test_a_backend_of_other_source_does_its_own_jobs_again(unfinished: Path, header: Header) -> None:
    kept, told = resumed(unfinished, changed(header, f"backend '{TWO}'"))
    assert kept == {FALL[ONE], REACH[ONE]}, "the replay plays what the changed backend recorded"
    assert told == f"backend '{TWO}' changed: to be done again are 3 of 5 jobs"
    assert resumed(unfinished, changed(header, f"backend '{TWO}'")) == (kept, ""), "they are told and dropped once"


@pytest.mark.parametrize(
    ("name", "kept"), [("the scenarios", {*REACH.values(), REPLAY}), ("task 'Reach'", {*FALL.values()})]
)
def test_scenarios_and_tasks_of_other_source_are_done_again(
    unfinished: Path, header: Header, name: str, kept: set[Job]
) -> None:
    assert resumed(unfinished, changed(header, name))[0] == kept


def test_a_core_of_other_source_is_refused_and_loses_nothing(unfinished: Path, header: Header) -> None:
    with pytest.raises(ConfigurationError, match="unfinished run of other source of orbit_core: --fresh begins anew"):
        Journal(unfinished, changed(header, CORE))
    assert resumed(unfinished, header)[0] == ALL


def test_every_job_depends_on_digests_that_the_header_has() -> None:
    settings = choose(backends=(ONE, TWO), scenarios=("free_fall",), parts=("scenarios", "tasks", "transfers"))
    named = {name for phase in plan(settings) for job in phase.jobs for name in sources_of(job)}
    assert named == {*source_digests(settings)}


def test_a_digest_is_of_a_plugins_files_and_of_those_that_it_shares(tmp_path: Path) -> None:
    """Each distribution that requires ``orbit-core`` and is required by the plugin counts."""
    plugin = {"plugin_a": ["orbit-core", "plugin-shared"], "plugin_shared": ["orbit-core", "torch"]}
    for package, requires in plugin.items():
        (tmp_path / package).mkdir()
        (tmp_path / package / "__init__.py").write_text(_PLUGIN if package == "plugin_a" else "SHARED = 1\n")
        about = tmp_path / f"{package}-1.dist-info"
        about.mkdir()
        lines = [f"Requires-Dist: {each}>=0; python_version > '3'" for each in requires]
        name = package.replace("_", "-")
        (about / "METADATA").write_text("\n".join(["Metadata-Version: 2.1", f"Name: {name}", "Version: 1", *lines]))
    (tmp_path / "plugin_a-1.dist-info" / "entry_points.txt").write_text("[orbit.backends]\na = plugin_a:Plugin\n")
    script = (
        "from orbit_conformance.settings import choose\n"
        "from orbit_conformance.sources import backend_packages, source_digests\n"
        "print(backend_packages('a'), source_digests(choose(backends=['a'], scenarios=['free_fall'])))\n"
    )

    def told() -> str:
        done = run_forked(script, path=[tmp_path])
        assert done.returncode == 0, done.stderr
        return done.stdout

    before = told()
    assert "('plugin_a', 'plugin_shared')" in before
    assert told() == before
    (tmp_path / "plugin_shared" / "__init__.py").write_text("SHARED = 2\n")
    assert told() != before


_PLUGIN = """
from dataclasses import dataclass
from orbit_core.interfaces import Backend, Capabilities

@dataclass(frozen=True)
class Config:
    pass

class Plugin(Backend):
    name, contract, config_type = "a", (1, 0), Config

    def capabilities(self):
        return Capabilities({})

    def create_engine(self, layout, num_envs, device, config):
        raise NotImplementedError
"""


def test_a_plugins_own_package_is_among_its_source() -> None:
    for name in backend_names():
        assert any(package.startswith("orbit_") for package in backend_packages(name))


def test_no_job_runs_what_is_left_out_of_the_cores_digest() -> None:
    script = (
        "import sys; import orbit_conformance.execution;"
        "left_out = [n for n in sys.modules if n.startswith(('orbit_core.cli', 'orbit_conformance.report'))];"
        "sys.exit(f'loaded {left_out}' if left_out else 0)"
    )
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, timeout=60)
    assert done.returncode == 0, done.stderr


def test_a_second_run_into_a_folder_is_refused_with_the_first_ones_process(tmp_path: Path, header: Header) -> None:
    first = Journal(tmp_path, header)
    with pytest.raises(ConfigurationError, match=rf"a run of process {os.getpid()} on .* is writing into folder"):
        Journal(tmp_path, header)
    first.close()
    Journal(tmp_path, header).close()


def test_the_lock_of_a_dead_process_is_taken_over(tmp_path: Path, header: Header) -> None:
    script = (
        "import os, sys; from pathlib import Path; from orbit_core.files import FolderLock;"
        "lock = FolderLock(Path(sys.argv[1])); os._exit(0)"
    )
    assert run_forked(script, str(tmp_path)).returncode == 0
    assert (tmp_path / ".lock").read_text(), "it died with the lock"
    Journal(tmp_path, header).close()


@pytest.mark.parametrize("files", [{}, {"recording.npz": b"long"}], ids=["a record", "a record's file"])
def test_a_full_disk_is_told_in_one_line_and_leaves_the_journal_readable(
    files: dict[str, bytes], unfinished: Path, header: Header, monkeypatch: pytest.MonkeyPatch
) -> None:
    before = {path for path in unfinished.rglob("*") if path.is_file()}
    with monkeypatch.context() as patch:
        journal = Journal(unfinished, header)
        patch.setattr(os, "fsync", _no_space)
        with pytest.raises(StorageError, match=r"cannot write .*No space left on device"):
            journal.add(Outcome(Record(Job(Kind.VIDEO, "Reach", ONE), Ending.DONE), files))
        with pytest.raises(StorageError, match=r"cannot write .*result\.json: No space left on device"):
            journal.finish()
        journal.close()
    assert {path for path in unfinished.rglob("*") if path.is_file()} == before
    assert resumed(unfinished, header)[0] == ALL
    assert not (unfinished / RESULT_FILE).exists()


def _no_space(file: int) -> None:
    raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))


@pytest.mark.parametrize("error", [OSError(errno.ENOSPC, "No space left on device"), StorageError("cannot write a")])
def test_a_full_disk_is_no_outcome_of_a_job(error: Exception, monkeypatch: pytest.MonkeyPatch) -> None:
    """The job is done when there is room again; any other failure of files is the job's own."""

    def fail(error: Exception) -> Callable[..., None]:
        def run(*arguments: object) -> None:
            raise error

        return run

    monkeypatch.setattr(execution, "run_scenario", fail(error))
    with pytest.raises(StorageError, match="cannot write"):
        execution.execute(FALL[ONE], SETTINGS, {})
    monkeypatch.setattr(execution, "run_scenario", fail(FileNotFoundError("where")))
    assert execution.execute(FALL[ONE], SETTINGS, {}).record.ending is Ending.ERROR


def test_a_damaged_journal_is_told_with_the_remedy(unfinished: Path, header: Header) -> None:
    lines = (unfinished / JOURNAL).read_text().splitlines(keepends=True)
    (unfinished / JOURNAL).write_text("".join([*lines[:2], "{}\n", *lines[3:]]))
    with pytest.raises(ConfigurationError, match=r"journal\.jsonl is no journal of this version .* --fresh"):
        Journal(unfinished, header)


def test_backend_settings_are_part_of_a_run(unfinished: Path) -> None:
    other = dataclasses.replace(SETTINGS, backend_settings={ONE: {"whatever": (1, 2)}})
    with pytest.raises(ConfigurationError, match="unfinished run of other settings"):
        Journal(unfinished, header_of(other))
    journal = Journal(unfinished, header_of(other), fresh=True)
    journal.close()
    resumed(unfinished, header_of(other))
    journal = Journal(unfinished, header_of(other))
    journal.finish()
    journal.close()
    assert load(unfinished).header.settings.backend_settings == {ONE: {"whatever": [1, 2]}}
