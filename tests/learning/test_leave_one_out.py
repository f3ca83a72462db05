"""The script that leaves one engine out: its trainings and evaluations, and its tables."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

FOLDER = Path(__file__).parents[2] / "benchmarks" / "learning"


@pytest.fixture(autouse=True)
def scripts(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    monkeypatch.syspath_prepend(str(FOLDER))
    yield
    for name in ("work", "table2", "table2_page", "leave_one_out"):
        sys.modules.pop(name, None)


def test_every_engine_is_left_out_once(tmp_path: Path) -> None:
    from leave_one_out import study_jobs  # pyright: ignore[reportMissingImports]

    settings: dict[str, Any] = {
        "tasks": ["Stack"], "engines": ["mujoco", "sapien", "bullet"], "seeds": 2, "envs": 48, "iterations": None,
        "length": None, "episodes": 50, "output": tmp_path,
    }  # fmt: skip
    jobs = {job.name: job for job in study_jobs(argparse.Namespace(**settings))}
    trained = [name for name in jobs if name.startswith("train.")]
    assert len(trained) == 2 * 9
    assert len(jobs) == 4 * len(trained)
    words = list(jobs["train.Stack.on-sapien-bullet.0"].words())
    at = words.index("--backend")
    assert words[at : at + 3] == ["--backend", "sapien", "bullet"]
    assert "bullet.workers=2" in words
    assert "domain_randomization=false" in words
    assert "domain_randomization=true" in jobs["train.Stack.drawn-mujoco.1"].words()
    evaluated = jobs["evaluate.Stack.drawn-mujoco.1.bullet"]
    assert evaluated.needs == ("train.Stack.drawn-mujoco.1",)
    assert {"domain_randomization=false", "bullet"} <= set(evaluated.words()), "nothing is drawn where it is judged"
    starts = {list(job.words())[-5] for name, job in jobs.items() if name.startswith("evaluate.")}
    assert starts == {"10000"}, "all policies have the same starts"
    assert list(jobs).index("evaluate.Stack.drawn-bullet.0.bullet") < list(jobs).index("train.Stack.on-mujoco.1")


def test_the_tables_add_up_the_seeds_and_the_engines_that_taught(tmp_path: Path) -> None:
    from leave_one_out import page  # pyright: ignore[reportMissingImports]

    def done(*successes: int) -> dict[str, Any]:
        return {"ended": True, "result": [{"successes": count, "trials": 10} for count in successes]}

    jobs = {
        "train.Reach.on-mujoco.0": {"ended": True, "result": None},
        "evaluate.Reach.on-mujoco-bullet.0.sapien": done(10),
        "evaluate.Reach.on-mujoco-bullet.1.sapien": done(8),
        "evaluate.Reach.on-mujoco.0.sapien": done(4),
        "evaluate.Reach.on-bullet.0.sapien": done(0),
        "evaluate.Reach.on-sapien.0.sapien": done(9),
        "evaluate.Reach.drawn-bullet.0.sapien": {"ended": False, "result": None},
    }
    text = page({"settings": {"engines": ["mujoco", "sapien", "bullet"]}, "jobs": jobs})
    assert "| Reach | sapien | 18 of 20 [70, 97] | 4 of 20 [8, 42] | not run |" in text
    assert "| Reach | mujoco | not run | not run | not run |" in text
    assert "| Reach | mujoco, bullet | not run | 18 of 20 [70, 97] (left out) | not run |" in text
    assert "| Reach | sapien | not run (left out) | 9 of 10 [60, 98] | not run (left out) |" in text
