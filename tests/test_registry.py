"""A broken package is named and left out, and stops only those who ask for what it would have brought."""

from __future__ import annotations

import subprocess
from pathlib import Path

import pytest

from tests.forked import run_forked

_CODE = """
def register_fine(registry):
    registry.add("Juggle", "Keep three balls in the air", "theirs:Juggle")

def register_halfway(registry):
    registry.add("Halfway", "Never seen", "theirs:Halfway")
    raise RuntimeError("no licence found")

def register_leaving(registry):
    raise SystemExit(3)

def register_known(registry):
    registry.add("Lift", "Another lift", "theirs:Lift")

def juggle(words):
    print("juggling", *words)
    return 7

def register_robot(catalogue):
    catalogue.add(None)
"""


def orbit(folder: Path, group: str, points: str, *words: str) -> subprocess.CompletedProcess[str]:
    """``orbit WORDS`` where a distribution 'theirs' with these entry points is installed beside ORBIT."""
    (folder / "theirs.py").write_text(_CODE)
    about = folder / "theirs-1.0.dist-info"
    about.mkdir()
    (about / "METADATA").write_text("Metadata-Version: 2.1\nName: theirs\nVersion: 1.0\n")
    (about / "entry_points.txt").write_text(f"[{group}]\n{points}\n")
    code = "import sys; from orbit_core.cli import main; sys.exit(main(sys.argv[1:]))"
    return run_forked(code, *words, path=[folder])


@pytest.mark.parametrize(
    ("point", "complaint"),
    [
        ("a = theirs:register_halfway", "RuntimeError: no licence found"),
        ("a = theirs:register_leaving", "SystemExit: 3"),
        ("a = theirs:nothing", "AttributeError"),
        ("a = not_there:register", "ModuleNotFoundError: No module named 'not_there'"),
    ],
)
def test_a_broken_task_package_is_named_and_left_out(tmp_path: Path, point: str, complaint: str) -> None:
    listed = orbit(tmp_path, "orbit.tasks", f"{point}\nb = theirs:register_fine", "list", "tasks")
    assert listed.returncode == 0
    assert {"Lift", "Juggle"} <= {line.split()[0] for line in listed.stdout.splitlines()}
    assert "Halfway" not in listed.stdout
    told = " ".join(listed.stderr.split())
    assert "warning: entry point 'a'" in told
    assert "of distribution theirs" in told
    assert complaint in told
    assert "Traceback" not in told


def test_what_a_broken_package_would_have_brought_is_told_to_who_asks(tmp_path: Path) -> None:
    asked = orbit(tmp_path, "orbit.tasks", "a = theirs:register_halfway", "info", "Halfway")
    assert asked.returncode == 2
    assert "no licence found" in asked.stderr


def test_a_name_that_two_packages_bring_stops_only_who_asks_for_it(tmp_path: Path) -> None:
    points = "a = theirs:register_known\nb = theirs:register_fine"
    listed = orbit(tmp_path, "orbit.tasks", points, "list", "tasks")
    assert "Reach" in listed.stdout
    assert "Juggle" in listed.stdout
    assert "task 'Lift' is registered twice" in " ".join(listed.stderr.split())


def test_a_broken_robot_package_leaves_the_other_robots(tmp_path: Path) -> None:
    listed = orbit(tmp_path, "orbit.robots", "a = theirs:register_robot", "list", "robots")
    assert "franka_panda" in listed.stdout
    assert "theirs:register_robot" in " ".join(listed.stderr.split())


def test_a_package_adds_a_command(tmp_path: Path) -> None:
    done = orbit(tmp_path, "orbit.commands", "juggle = theirs:juggle", "juggle", "3", "--high")
    assert (done.returncode, done.stdout) == (7, "juggling 3 --high\n")


def test_a_broken_command_names_its_package_and_leaves_the_others(tmp_path: Path) -> None:
    points = "juggle = theirs:nothing\nlist = theirs:juggle"
    asked = orbit(tmp_path, "orbit.commands", points, "juggle")
    assert asked.returncode == 2
    assert "command 'juggle', entry point 'juggle' (theirs:nothing, of distribution theirs)" in asked.stderr
    assert "Traceback" not in asked.stderr
    usage = run_forked("from orbit_core.cli import main; main(['--help'])", path=[tmp_path])
    assert "entry point 'juggle'" in usage.stdout
    told = " ".join(usage.stderr.split())
    assert "command 'list' is registered twice" in told
    assert "the former is used" in told
    assert "Names of all tasks" in usage.stdout


def test_an_unknown_command_offers_the_nearest(tmp_path: Path) -> None:
    asked = orbit(tmp_path, "orbit.commands", "juggle = theirs:juggle", "jugle")
    assert asked.returncode == 2
    assert "did you mean 'juggle'" in asked.stderr


def test_a_package_brings_a_learning_library(tmp_path: Path) -> None:
    """It is listed without being imported; what is no trainer, or broken, is named once it is asked for."""
    points = "mine = theirs:juggle\nlost = theirs:nothing"
    listed = orbit(tmp_path, "orbit.learners", points, "list", "libraries")
    assert listed.returncode == 0
    assert {"rsl-rl", "distill", "mine", "lost"} <= {line.split()[0] for line in listed.stdout.splitlines()}
    assert "of distribution theirs" in listed.stdout
    command = "import sys; from orbit_learn.learners import trainer_type; trainer_type(sys.argv[1])"
    for name, complaint in (
        ("mine", "is no Trainer"),
        ("lost", "cannot be loaded (AttributeError"),
        ("rsl_rl", "did you mean 'rsl-rl'"),
    ):
        asked = run_forked(command, name, path=[tmp_path])
        assert asked.returncode != 0
        assert complaint in asked.stderr
