"""The script of the paper's table of imitation: its jobs, how they go on, and its page."""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

FOLDER = Path(__file__).parents[2] / "benchmarks" / "imitation"


@pytest.fixture(autouse=True)
def scripts(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    monkeypatch.syspath_prepend(str(FOLDER))
    yield
    for name in ("work", "table2", "table2_page", "yields", "pictures"):
        sys.modules.pop(name, None)


def test_a_job_begins_after_what_it_needs_and_is_done_once(tmp_path: Path) -> None:
    from work import Job, Ledger, run_jobs  # pyright: ignore[reportMissingImports]

    words = ["list", "libraries"]
    jobs = [
        Job("second", lambda: words, ("first",), read=lambda: {"from": (tmp_path / "logs/first.log").read_text()[:3]}),
        Job("first", lambda: words),
        Job("wrong", lambda: ["list", "nothing"]),
        Job("never", lambda: words, ("wrong",)),
    ]
    path = tmp_path / "results.json"
    assert not run_jobs(jobs, Ledger(path, {"demos": 1}), 2, 600.0, tmp_path / "logs", 0)
    again = Ledger(path, {"demos": 1})
    assert {name for name in again.jobs if again.ended(name)} == {"first", "second"}
    assert again.jobs["second"].result == {"from": (tmp_path / "logs/first.log").read_text()[:3]}
    assert again.jobs["first"].core_seconds > 0.0
    before = (tmp_path / "logs/first.log").read_text()
    assert run_jobs(jobs[:2], again, 2, 600.0, tmp_path / "logs", 0)
    assert (tmp_path / "logs/first.log").read_text() == before
    with pytest.raises(SystemExit, match="other demos"):
        Ledger(path, {"demos": 2})


def test_jobs_begin_in_their_order(tmp_path: Path) -> None:
    from work import Job, Ledger, run_jobs  # pyright: ignore[reportMissingImports]

    begun: list[str] = []

    def words(name: str) -> list[str]:
        begun.append(name)
        return ["list", "nothing"]

    names = ["cell 1", "cell 2", "cell 3"]
    jobs = [Job(name, lambda name=name: words(name)) for name in names]
    assert not run_jobs(jobs, Ledger(tmp_path / "results.json", {}), 1, 600.0, tmp_path / "logs", 0)
    assert begun == names


def test_a_job_of_two_cores_waits_for_both(tmp_path: Path) -> None:
    from work import Job, Ledger, run_jobs  # pyright: ignore[reportMissingImports]

    seen: list[str] = []

    def words(name: str) -> list[str]:
        seen.append(f"{name} begins")
        return ["list", "libraries"]

    jobs = [
        Job(name, lambda name=name: words(name), read=lambda name=name: seen.append(f"{name} ends"), cores=cores)
        for name, cores in (("one", 1), ("two", 2))
    ]
    assert run_jobs(jobs, Ledger(tmp_path / "results.json", {}), 2, 600.0, tmp_path / "logs", 0)
    assert seen == ["one begins", "one ends", "two begins", "two ends"]


def test_a_training_that_was_killed_goes_on_unless_it_had_its_last_iteration(tmp_path: Path) -> None:
    from table2 import continued  # pyright: ignore[reportMissingImports]

    folder = tmp_path / "bc-0"
    assert continued(folder, 60) == ("--output", str(folder))
    folder.mkdir()
    (folder / "checkpoint_40.safetensors").touch()
    assert continued(folder, 60) == ("--resume", str(folder))
    (folder / "checkpoint_59.safetensors").touch()
    assert continued(folder, 60) == ("--output", str(folder)), "nothing is left to resume"
    assert not folder.exists()


def test_nothing_outlasts_the_budget(tmp_path: Path) -> None:
    from work import Job, Ledger, run_jobs  # pyright: ignore[reportMissingImports]

    jobs = [Job("late", lambda: ["list", "libraries"])]
    assert not run_jobs(jobs, Ledger(tmp_path / "results.json", {}), 1, 1.0, tmp_path / "logs", 0)
    assert not (tmp_path / "logs/late.log").exists(), "there is no time to begin it"


def test_every_cell_is_recorded_trained_and_evaluated(tmp_path: Path) -> None:
    from table2 import CELLS, table_jobs  # pyright: ignore[reportMissingImports]

    settings: dict[str, Any] = {
        "jobs": 1, "demos": 1001, "seeds": 2, "episodes": 100, "algorithms": ["bc", "act"], "iterations": None,
        "actions": ["joint_position", "pictures"], "cells": [cell.name for cell in CELLS], "engine": "mujoco",
        "transfer": ["bullet"], "device": "cpu", "eager": False, "renderer": "sapien", "renderer_setting": [],
        "output": tmp_path,
    }  # fmt: skip
    jobs = {job.name: job for job in table_jobs(argparse.Namespace(**settings))}
    assert all(need in jobs for job in jobs.values() for need in job.needs)
    recorded = [list(job.words()) for name, job in jobs.items() if name.startswith("record.both.joint_position")]
    counts = [int(words[words.index("--episodes") + 1]) for words in recorded]
    assert counts == [251, 250, 250, 250]
    assert ["--noise" in words for words in recorded] == [False, True, False, True]
    assert len({words[words.index("--seed") + 1] for words in recorded}) == 4
    assert "start_spread=0.0" in jobs["train.goal.joint_position.act.1"].words()
    assert "--cameras" in jobs["record.both.pictures.0"].words()
    assert sum(name.startswith("evaluate.both.pictures.bc.bullet") for name in jobs) == 25
    assert "evaluate.both.joint_position.bc.bullet.0" in jobs
    # One job compiles what evaluations on an engine need.
    assert "first.all.joint_position.bullet" in jobs["evaluate.both.joint_position.bc.bullet.0"].needs
    assert not any(need.startswith("first") for need in jobs["evaluate.both.joint_position.bc.mujoco.0"].needs)
    assert "--cameras" in jobs["first.all.pictures.bullet"].words()
    # All seeds of an algorithm, and their evaluations, come before the next algorithm, and a cell before the next.
    places = {name: place for place, name in enumerate(jobs)}
    order = [
        "record.none.joint_position.3", "train.none.joint_position.bc.1", "evaluate.none.joint_position.bc.bullet.0",
        "train.none.joint_position.act.0", "evaluate.none.joint_position.act.mujoco.0", "record.goal.joint_position.0",
    ]  # fmt: skip
    assert sorted(order, key=places.__getitem__) == order


def test_the_page_adds_parts_up_and_shows_what_was_published(tmp_path: Path) -> None:
    from table2_page import page  # pyright: ignore[reportMissingImports]

    def done(successes: int, trials: int, length: float) -> dict[str, Any]:
        result = [{"policy": "bc-0", "engine": "x 1", "successes": successes, "trials": trials, "length": length}]
        return {"ended": True, "seconds": 1.0, "core_seconds": 2.0, "result": result}

    settings = {"demos": 2, "engine": "mujoco", "seeds": 1, "episodes": 20}
    jobs = {
        "evaluate.both.joint_position.bc.mujoco.0": done(10, 10, 100.0),
        "evaluate.both.joint_position.bc.mujoco.1": done(0, 10, 200.0),
    }
    text = page(json.loads(json.dumps({"settings": settings, "jobs": jobs})))
    assert "| `bc` | not run | not run | not run | 0.50 [0.30, 0.70], 150 |" in text
    assert "| `bc`, published | 1.00, 234 | 0.89, 307 | 0.47, 321 | 0.43, 324 |" in text


def test_results_of_several_machines_become_one_table() -> None:
    from table2_page import merged  # pyright: ignore[reportMissingImports]

    settings = {"demos": 2, "engine": "mujoco"}
    first = {"settings": settings, "jobs": {"a": {"ended": False}, "b": {"ended": True, "result": [1]}}}
    second = {"settings": settings, "jobs": {"a": {"ended": True, "result": [2]}, "b": {"ended": False}}}
    both = merged([first, second])
    assert [job["result"] for job in both["jobs"].values()] == [[2], [1]]
    with pytest.raises(SystemExit, match="other demos"):
        merged([first, {"settings": {"demos": 3, "engine": "mujoco"}, "jobs": {}}])


def test_results_of_an_algorithm_that_has_changed_are_left_out() -> None:
    from table2_page import without  # pyright: ignore[reportMissingImports]

    names = [
        "record.both.joint_position.0",
        "train.both.joint_position.bc.0",
        "evaluate.both.joint_position.act.warp.0",
    ]
    ledger = {"settings": {"demos": 2}, "jobs": dict.fromkeys((*names, "train.both.ik.bc-rnn.0"))}
    assert list(without(ledger, ["bc-rnn"])["jobs"]) == names
    assert list(without(ledger, ["bc-rnn", "act"])["jobs"]) == names[:2]
    assert without(ledger, [])["settings"] == {"demos": 2}


def test_results_of_fewer_trainings_are_shown_until_all_are_done() -> None:
    from table2_page import merged, page  # pyright: ignore[reportMissingImports]

    def ledger(seeds: int, ended: bool = True) -> dict[str, Any]:
        result = [
            {"policy": f"bc-{seed}", "engine": "x 1", "successes": 9, "trials": 10, "length": 50.0}
            for seed in range(seeds)
        ]
        job = {"ended": ended, "seconds": 1.0, "core_seconds": 2.0, "result": result if ended else None}
        settings = {"demos": 2, "engine": "mujoco", "episodes": 10, "seeds": seeds}
        return {"settings": settings, "jobs": {"evaluate.both.ik_relative.bc.mujoco.0": job}}

    begun = merged([ledger(3, ended=False), ledger(1)])
    (job,) = begun["jobs"].values()
    assert begun["settings"]["seeds"] == 3
    assert not job["ended"], "it is still to be done with three"
    assert "| not run | 0.90 [0.60, 0.98], 50, 1 training |" in page(begun)
    whole = merged([begun, ledger(3), ledger(2)])
    (job,) = whole["jobs"].values()
    assert job["ended"]
    assert "training |" not in page(whole)
    with pytest.raises(SystemExit, match="other seeds"):
        merged([ledger(1), ledger(3)])


def test_what_is_gone_is_made_again_only_where_it_is_needed(tmp_path: Path) -> None:
    from work import Done, Job, Ledger, _left, run_jobs  # pyright: ignore[reportMissingImports]

    words = ["list", "libraries"]
    jobs = [
        Job("recorded", lambda: words, leaves=tmp_path / "gone"),
        Job("trained", lambda: words, ("recorded",), leaves=tmp_path / "gone too"),
        Job("evaluated", lambda: words, ("trained",)),
        Job("evaluated elsewhere", lambda: words, ("trained",)),
    ]
    ledger = Ledger(tmp_path / "results.json", {})
    ledger.jobs = {job.name: Done(ended=True) for job in jobs}
    assert run_jobs(jobs, ledger, 1, 600.0, tmp_path / "logs", 0)
    assert not list((tmp_path / "logs").glob("*.log")), "all is evaluated"
    ledger.jobs["evaluated elsewhere"] = Done()
    assert list(_left(jobs, ledger)) == ["recorded", "trained", "evaluated elsewhere"], "in the order of the jobs"
    assert run_jobs(jobs, ledger, 1, 600.0, tmp_path / "logs", 0)
    assert {log.stem for log in (tmp_path / "logs").glob("*.log")} == {"recorded", "trained", "evaluated elsewhere"}


def test_a_policy_of_pictures_is_recorded_in_parts_trained_and_evaluated(tmp_path: Path) -> None:
    from pictures import picture_jobs, table  # pyright: ignore[reportMissingImports]

    settings: dict[str, Any] = {
        "output": tmp_path, "demos": 8, "parts": 4, "backend": "warp", "device": "cuda", "renderer_setting": [],
        "cameras": ["front:84x84"], "algorithms": ["act"], "iterations": 2, "episodes": 10,
    }  # fmt: skip
    jobs = {job.name: job for job in picture_jobs(argparse.Namespace(**settings))}
    assert ["--noise" in jobs[f"record.{part}"].words() for part in range(4)] == [False, True, False, True]
    assert jobs["record.3"].needs == ("record.0",), "the first compiles kernels"
    assert jobs["train.act"].needs == tuple(f"record.{part}" for part in range(4))
    assert list(jobs["train.act"].words()).count("--dataset") == 4
    result = [{"successes": 8, "trials": 10}]
    assert "| act | 80.0 % [" in table({"evaluate.act": {"ended": True, "result": result}})


def test_yields_are_read_from_what_augmentations_print(tmp_path: Path) -> None:
    from yields import table, yield_jobs  # pyright: ignore[reportMissingImports]

    settings: dict[str, Any] = {
        "tasks": ["Lift", "Stack"], "backends": ["mujoco", "sapien"], "recorded_on": "mujoco", "demonstrations": 3,
        "attempts": 8, "output": tmp_path,
    }  # fmt: skip
    jobs = {job.name: job for job in yield_jobs(argparse.Namespace(**settings))}
    assert len(jobs) == 2 + 2 * 2 * 2
    assert all(need in jobs for job in jobs.values() for need in job.needs)
    (tmp_path / "augment.Lift.mujoco.skillgen.log").write_text("x: 6 kept; 7 of 8 attempts on mujoco\nsucceeded")
    (tmp_path / "augment.Lift.sapien.skillgen.log").write_text("none of 8 attempts succeeded: use others")
    (tmp_path / "augment.Stack.sapien.mimicgen.log").write_text("interrupted")
    head, _, row = table(tmp_path).splitlines()
    assert head == "| task | method | mujoco | sapien |"
    assert row.startswith("| Lift | skillgen | 87.5 % [")
    assert "| 0.0 % [0" in row
