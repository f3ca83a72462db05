"""Runs of the suite that several tests look at, and the fixtures of the contract tests."""

from __future__ import annotations

import fcntl
import os
import subprocess
import sys
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

import pytest

from orbit_conformance.contract.fixtures import backend, device, make_engine, needs
from orbit_conformance.execution import Outcome, execute
from orbit_conformance.merge import merge
from orbit_conformance.pools import Work
from orbit_conformance.report.page import write_report
from orbit_conformance.runner import run
from orbit_conformance.settings import Part, choose
from orbit_core import backends

from . import broken_plugin

__all__ = ["backend", "device", "make_engine", "needs"]
PAIR = backends.backend_names()[:2]
PROGRAM = [sys.executable, "-c", "import sys; from orbit_core.cli import main; sys.exit(main())", "conformance"]


class Here:
    """Does jobs in this process."""

    def run(self, work: Sequence[Work], alone: bool) -> Iterator[Outcome]:
        return (execute(*one) for one in work)

    def close(self) -> None:
        pass


def _made_once(factory: pytest.TempPathFactory, name: str, make: Callable[[Path], None]) -> Path:
    """Return a folder that the first worker to ask fills, for all workers of this session."""
    base = factory.getbasetemp()
    folder = (base.parent if "PYTEST_XDIST_WORKER" in os.environ else base) / name
    with folder.with_suffix(".lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        made = folder.with_suffix(".made")
        if not made.exists():
            folder.mkdir(exist_ok=True)
            make(folder)
            made.touch()
    return folder


@pytest.fixture(scope="session")
def finished_run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the folder of a run of one scenario, robot and task and the policy kept for it, on two backends."""
    chosen = {"scenarios": ["free_fall"], "robots": ["cartpole"], "tasks": ["Reach"]}
    settings = choose(backends=PAIR, parts=[part.value for part in Part], quick=True, episodes=2, **chosen)
    return _made_once(tmp_path_factory, "finished-run", lambda folder: run(settings, folder, Here()) and None)


@pytest.fixture(scope="session")
def broken_run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the folder of a command's run on backends that die, hang and work; ``told`` holds its output."""

    def make(folder: Path) -> None:
        output, plugin = folder / "run", folder / "plugin"
        plugin.mkdir()
        words = ["--quick", "--scenario", "projectile", "--backend", "dying", "hanging", PAIR[0]]
        words += ["--episodes", "2", "--time-limit", "20", "--output", str(output)]
        environment = os.environ | {"OMP_NUM_THREADS": "1"} | broken_plugin.install(plugin)
        done = subprocess.run([*PROGRAM, *words], capture_output=True, text=True, timeout=600, env=environment)
        assert done.returncode == 1, done.stderr
        (output / "told").write_text(done.stdout)

    return _made_once(tmp_path_factory, "broken-run", make) / "run"


@pytest.fixture(scope="session")
def report_page(finished_run: Path, broken_run: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the page of both runs as one."""

    def make(folder: Path) -> None:
        merge((finished_run, broken_run), folder / "merged")
        write_report(folder / "merged")

    return _made_once(tmp_path_factory, "report", make) / "merged" / "report.html"
