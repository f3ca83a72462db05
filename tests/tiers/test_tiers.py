"""Every slow test has its turn, a change brings its own, and a run says what is missing."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace

import pytest

from orbit_core.backends import backend_names
from tests.tiers.__main__ import refresh
from tests.tiers.conformance import TASK_BACKENDS, runs, touched_jobs
from tests.tiers.plugin import Tiers
from tests.tiers.revision import Revision, current_revision
from tests.tiers.selection import CHANGE_SECONDS, select
from tests.tiers.slow_list import SLOW_SECONDS, TURNS, read_slow_list, refreshed, turns, write_slow_list
from tests.tiers.spread import KERNELS, MATTER_KERNELS, group_of
from tests.tiers.touched import touched_backends, touched_tests
from tests.tiers.types import TYPE_TURNS, checked_files, concerned, share

ROOT = Path(__file__).parents[2]
LISTED = {f"tests/x/test_{i}.py::test_{i}": 2.0 + i for i in range(2 * TURNS)}


def test_sixty_commits_in_a_row_run_every_slow_test_once() -> None:
    runs = [select(LISTED, Revision(turn), ()).chosen for turn in range(TURNS)]
    assert sorted(name for run in runs for name in run) == sorted(LISTED)
    shares = [sum(LISTED[name] for name in run) for run in runs]
    assert max(shares) < 1.5 * min(shares)
    assert turns(dict(reversed(LISTED.items()))) == turns(LISTED)


def test_what_a_change_concerns_runs_whatever_the_turn() -> None:
    name = next(name for name, turn in turns(LISTED).items() if turn != 3 and LISTED[name] <= CHANGE_SECONDS)
    selection = select(LISTED, Revision(3), {name, "tests/of_no_list.py::test"})
    assert name in selection.chosen
    assert selection.by_change == {name}
    assert "and 1 more that the change concerns" in selection.describe(3)


def test_a_change_that_concerns_everything_runs_what_time_allows_and_tells_how_many_it_left() -> None:
    whole = {f"tests/x/test_{i}.py::test": 10.0 for i in range(7 * TURNS)}
    selection = select(whole, Revision(3), whole)
    more = selection.chosen - selection.by_turn
    assert sum(whole[name] for name in more) == CHANGE_SECONDS
    assert {turns(whole)[name] for name in more} == {4}
    assert selection.left == len(whole) - len(selection.chosen) > 0
    assert f"{selection.left} more wait for their turn" in selection.describe(3)


def test_a_list_comes_back_from_its_file(tmp_path: Path) -> None:
    listed = {"tests/a.py::test[b c-1.5]": 12.3, "scenario/free_fall": 2.0}
    write_slow_list(listed, tmp_path / "slow.txt")
    assert read_slow_list(tmp_path / "slow.txt") == listed
    assert read_slow_list(tmp_path / "none.txt") == {}


def test_a_refresh_adds_what_grew_drops_what_shrank_or_is_gone_and_keeps_what_did_not_run() -> None:
    listed = {"shrank": 9.0, "gone": 9.0, "not run": 9.0, "wavers": SLOW_SECONDS}
    measured = {"grew": 5.0, "shrank": 0.5 * SLOW_SECONDS, "fast": 0.9 * SLOW_SECONDS, "wavers": 0.9 * SLOW_SECONDS}
    after = refreshed(listed, measured, ["gone"])
    assert after == {"grew": 5.0, "not run": 9.0, "wavers": 0.9 * SLOW_SECONDS}


def test_a_refresh_without_a_measurement_changes_nothing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("tests.tiers.conformance.OUTPUT", tmp_path)
    assert refresh(tmp_path, tmp_path / "slow.txt") == 1
    assert not (tmp_path / "slow.txt").exists()


def test_every_name_of_the_list_is_of_a_file_that_is_there() -> None:
    files = {name.partition("::")[0] for name in read_slow_list() if "::" in name}
    assert {name for name in files if not (ROOT / name).is_file()} == set()


def _git(folder: Path, *words: str) -> None:
    identity = {
        "GIT_AUTHOR_NAME": "a",
        "GIT_AUTHOR_EMAIL": "a@b",
        "GIT_COMMITTER_NAME": "a",
        "GIT_COMMITTER_EMAIL": "a@b",
    }
    subprocess.run(["git", *words], cwd=folder, check=True, capture_output=True, env=os.environ | identity)


def test_a_revision_is_the_commits_turn_and_what_differs_from_the_base(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for variable in ("ORBIT_TEST_BASE", "ORBIT_TEST_TURN"):
        monkeypatch.delenv(variable, raising=False)
    folder = tmp_path / "clone"
    folder.mkdir()
    assert current_revision(folder).note.startswith("no git history")
    _git(folder, "init", "-b", "main")
    for count in range(3):
        (folder / f"{count}.py").touch()
        _git(folder, "add", "-A")
        _git(folder, "commit", "-m", "one")
    assert current_revision(folder) == Revision(3, frozenset({"2.py"}))
    _git(folder, "checkout", "-b", "topic", "HEAD~1")
    (folder / "own.py").touch()
    _git(folder, "add", "-A")
    _git(folder, "commit", "-m", "own")
    (folder / "new.py").touch()
    assert current_revision(folder).changed == {"own.py", "new.py"}
    monkeypatch.setenv("ORBIT_TEST_BASE", "HEAD~2")
    monkeypatch.setenv("ORBIT_TEST_TURN", str(TURNS + 7))
    assert current_revision(folder) == Revision(7, frozenset({"own.py", "new.py", "1.py"}))


def test_a_shallow_clone_and_one_of_a_single_commit_say_so(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("ORBIT_TEST_BASE", raising=False)
    _git(tmp_path, "init", "-b", "main", "one")
    (tmp_path / "one" / "a.py").touch()
    _git(tmp_path / "one", "add", "-A")
    _git(tmp_path / "one", "commit", "-m", "one")
    assert current_revision(tmp_path / "one").note == "no base to compare with: changes are unknown"
    _git(tmp_path, "clone", "--depth", "1", f"file://{tmp_path / 'one'}", "two")
    assert 0 <= current_revision(tmp_path / "two").turn < TURNS


def test_a_change_concerns_the_tests_of_its_package_plugin_backend_and_importers() -> None:
    names = [
        "tests/envs/test_environment.py::test_a",
        "tests/tasks/test_jenga.py::test_b",
        "plugins/orbit-bullet/tests/test_bullet_workers.py::test_c",
        "tests/conformance/orbit_conformance/contract/test_conformance_rays.py::test_d[bullet-1]",
        "tests/conformance/orbit_conformance/contract/test_conformance_rays.py::test_d[sapien-1]",
    ]
    of = {
        "orbit_core/envs/task.py": {names[0]},
        "orbit_tasks/jenga.py": {names[1]},
        "plugins/orbit-bullet/orbit_bullet/engine.py": {names[2], names[3]},
        "tests/conformance/orbit_conformance/contract/test_conformance_rays.py": {names[3], names[4]},
        "docs/start.md": set(),
    }
    for path, expected in of.items():
        assert touched_tests(names, [path]) == expected, path


def test_a_change_of_a_shared_package_concerns_every_backend_that_is_built_on_it() -> None:
    assert touched_backends(["plugins/orbit-mjmodel/orbit_mjmodel/model.py"]) == {"mujoco", "warp"}
    assert touched_backends(["plugins/orbit-sapien/README.md", "orbit_core/files.py"]) == set()


def test_a_changed_plugin_runs_slow_scenarios_on_its_backend_for_as_long_as_a_change_may() -> None:
    names = {"scenario/free_fall": "a", "scenario/spin_down": "b", "robot/ur10": "c", "task/Lift": "orbit_tasks.lift"}
    assert touched_jobs(names, ["orbit_tasks/lift.py"]) == {"task/Lift"}
    changed = frozenset({"plugins/orbit-mujoco/orbit_mujoco/engine.py"})
    known = {"scenario/spin_down": 2.0, "task/Jenga": 3.0, **{f"scenario/long_{i}": 30.0 for i in range(200)}}
    found = runs(["scenario/free_fall", "task/Lift"], known, Revision(0, changed))
    assert found["scenarios"] == {"scenarios": ("free_fall",)}
    assert found["tasks"] == {"parts": ("tasks", "transfers"), "backends": TASK_BACKENDS, "tasks": ("Lift",)}
    touched = found["scenarios-touched"]
    assert touched["backends"] == ("mujoco",)
    seconds = sum(known[f"scenario/{name}"] for name in touched["scenarios"]) / len(backend_names())
    turn = sum(known.values()) / len(backend_names()) / TURNS
    assert CHANGE_SECONDS - 30.0 < seconds < CHANGE_SECONDS + 2.0 * turn
    assert "scenarios-touched" not in runs(["scenario/free_fall"], known, Revision(0))


def test_tests_of_what_is_made_once_share_a_turn_that_others_leave_to_them() -> None:
    seconds = {f"test_{i}": 1.0 for i in range(2 * TURNS)}
    together = {f"test_{i}": "made once" for i in range(5)}
    turn_of = turns(seconds, together)
    (turn,) = {turn_of[name] for name in together}
    assert [name for name in seconds if turn_of[name] == turn] == [*together]
    (chosen,) = {len(select(seconds, Revision(turn), (), together).chosen)}
    assert chosen == len(together)


def test_tests_that_compile_kernels_are_of_few_groups_and_others_go_by_file() -> None:
    contract = "tests/conformance/orbit_conformance/contract/test_conformance_rays.py"
    plugin = "plugins/orbit-warp/tests/test_a.py"
    for name in (f"{contract}::test_d[warp-1]", f"{contract}::test_d[1-newton]", f"{plugin}::test_b"):
        assert group_of(name) == KERNELS, name
    assert group_of("plugins/orbit-matter/tests/test_a.py::test_b[warp]") == MATTER_KERNELS
    assert group_of(f"{contract}::test_d[sapien-unwarped]") == contract


def test_every_other_worker_reads_files_backwards_and_all_agree_on_the_order(tmp_path: Path) -> None:
    for name in ("a", "b"):
        (tmp_path / f"test_{name}.py").write_text(f"print('read {name}')\ndef test_2(): pass\ndef test_1(): pass\n")
    options = ["-p", "tests.tiers.plugin", "-p", "no:cacheprovider", "-s", "-v", "--rootdir", str(tmp_path)]
    own = {"PYTHONPATH": str(ROOT), "PYTEST_DISABLE_PLUGIN_AUTOLOAD": "1"}
    for worker, order in (("gw0", ["a", "b"]), ("gw1", ["b", "a"])):
        done = subprocess.run(
            [sys.executable, "-m", "pytest", *options, str(tmp_path)],
            cwd=tmp_path,
            capture_output=True,
            text=True,
            env=os.environ | own | {"PYTEST_XDIST_WORKER": worker},
        )
        assert re.findall(r"read (\w)", done.stdout) == order, done.stdout + done.stderr
        ran = ["a.py::test_2", "a.py::test_1", "b.py::test_2", "b.py::test_1"]
        assert re.findall(r"test_(\w\.py::test_\d) PASSED", done.stdout) == ran, done.stdout


def test_consecutive_commits_check_the_types_of_every_file() -> None:
    files = checked_files()
    assert "orbit_core/envs/task.py" in files
    assert not [file for file in files if "/tests/" in file and file.startswith("plugins/")]
    shares = [share(files, Revision(turn), set()) for turn in range(TYPE_TURNS)]
    assert sorted(file for chosen, left in shares for file in chosen if not left) == files


def test_types_of_changed_files_and_importers_are_checked_whatever_the_turn() -> None:
    files = [
        file for file in checked_files() if file.startswith(("orbit_core/envs", "orbit_core/i", "plugins/orbit-b"))
    ]
    changed = frozenset({"orbit_core/interfaces/errors.py"})
    touched = concerned(files, changed)
    assert "orbit_core/envs/actors.py" in touched
    for turn in range(TYPE_TURNS):
        chosen, left = share(files, Revision(turn, changed), touched)
        assert {*chosen} >= changed
        assert left == len(touched) - len(touched & {*chosen}) > 0
        assert len(chosen) < 0.5 * len(files)
    plugin = "plugins/orbit-bullet/orbit_bullet/engine.py"
    assert concerned(files, {plugin}) == {file for file in files if file.startswith("plugins/orbit-bullet/")}


def test_a_quick_run_leaves_slow_tests_out_and_says_so(tmp_path: Path) -> None:
    """A whole run in a process of its own, on a list that names a slow test of each turn and one that is gone."""
    (tmp_path / "test_few.py").write_text("".join(f"def test_{i}(): pass\n" for i in range(2 * TURNS)))
    listed = {f"test_few.py::test_{i}": 5.0 for i in range(TURNS)} | {"test_few.py::test_gone": 5.0}
    options = ["-p", "tests.tiers.plugin", "-p", "no:cacheprovider", "--tier", "quick", "--rootdir", str(tmp_path)]
    code = (
        "import sys, pytest, tests.tiers.plugin as plugin\n"
        f"plugin.read_slow_list = lambda: {listed!r}\n"
        f"sys.exit(pytest.main({[*options, str(tmp_path)]!r}))"
    )
    own = {"PYTHONPATH": str(ROOT), "PYTEST_DISABLE_PLUGIN_AUTOLOAD": "1"}
    done = subprocess.run(
        [sys.executable, "-c", code], cwd=tmp_path, capture_output=True, text=True, env=os.environ | own
    )
    assert f"{TURNS + 1} passed, {TURNS - 1} deselected" in done.stdout, done.stdout + done.stderr
    assert f"1 of {TURNS} slow ones, 5 of {5 * TURNS} s" in done.stdout
    assert "names 1 tests that are gone" in done.stdout


def test_seconds_in_which_a_test_had_no_core_do_not_count(pytestconfig: pytest.Config) -> None:
    waited = iter((5.0, 7.0, 7.0))
    tiers = Tiers(pytestconfig, lambda: next(waited))
    for expected in (0.5, 2.5):
        report = SimpleNamespace(duration=2.5)
        phase = tiers.pytest_runtest_makereport()
        next(phase)
        with pytest.raises(StopIteration):
            phase.send(report)
        assert report.duration == expected


def test_caches_move_with_the_variable_and_a_folder_that_cannot_be_written_is_named(tmp_path: Path) -> None:
    script = ROOT / "tools" / "with_caches.sh"

    def caches(folder: Path) -> subprocess.CompletedProcess[str]:
        environment = os.environ | {"ORBIT_TEST_CACHE": str(folder)}
        words = ["sh", str(script), "sh", "-c", "echo $ORBIT_CACHE_DIR $WARP_CACHE_PATH $TORCHINDUCTOR_CACHE_DIR"]
        return subprocess.run(words, cwd=tmp_path, capture_output=True, text=True, env=environment, check=True)

    kept = caches(tmp_path / "kept")
    assert all(path.startswith(str(tmp_path / "kept")) for path in kept.stdout.split())
    assert kept.stderr == ""
    (tmp_path / "file").touch()
    other = caches(tmp_path / "file")
    assert all(path.startswith(str(tmp_path / "out" / "caches")) for path in other.stdout.split())
    assert "is used instead" in other.stderr
    assert len(other.stderr.splitlines()) == 1
