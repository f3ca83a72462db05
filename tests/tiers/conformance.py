"""Choose a commit's share of the suite: fast jobs, a thirtieth of the slow ones, what the change concerns."""

from __future__ import annotations

import json
import subprocess
import sys
from collections import defaultdict
from collections.abc import Iterable, Mapping
from pathlib import Path

from orbit_assets.catalogue import robot_info, robot_names
from orbit_conformance.scenarios import SCENARIOS
from orbit_core.backends import backend_names
from orbit_core.envs.registry import task_entries, task_entry
from tests.tiers.revision import Revision, current_revision
from tests.tiers.selection import select
from tests.tiers.slow_list import read_slow_list
from tests.tiers.touched import changed_modules, touched_backends

OUTPUT = Path("out/conformance")
"""Folder of the runs of ``make test-all``, by which the slow list is refreshed."""
QUICK_OUTPUT = Path("out/conformance-quick")
TASK_BACKENDS = ("mujoco", "sapien")
"""Robots, tasks and policies run on two backends; ``orbit conformance`` is the whole matrix."""


def run_quick(output: Path = QUICK_OUTPUT) -> int:
    """Run this commit's share of the suite and return 1 if a backend is not as it declares, else 0."""
    revision = current_revision()
    listed = {name: seconds for name, seconds in read_slow_list().items() if "::" not in name}
    names = suite_names()
    known = {name: seconds for name, seconds in listed.items() if name in names}
    selection = select(known, revision, touched_jobs(names, revision.changed))
    chosen = [name for name in names if name not in known or name in selection.chosen]
    program = [sys.executable, "-c", "import sys; from orbit_core.cli import main; sys.exit(main())", "conformance"]
    failed = 0
    for folder, arguments in commands(chosen, names, revision):
        # Fresh, for what an interrupted run of another commit left there is of other jobs.
        words = [*program, *arguments, "--fresh", "--output", str(output / folder)]
        failed |= subprocess.run(words, check=False).returncode
    print(f"conformance: {selection.describe(revision.turn)}")
    if gone := sorted({*listed} - {*names}):
        print(f"the slow list names {len(gone)} jobs that are gone (`make slow-list`): {gone[0]} ...")
    return int(failed != 0)


def suite_names() -> dict[str, str]:
    """Return the module of each job of the quick run by name: ``scenario/NAME``, ``robot/NAME`` or ``task/NAME``."""
    scenarios = {f"scenario/{s.name}": s.run.__module__ for s in SCENARIOS if not s.slow}
    robots = {f"robot/{name}": _module_of_robot(name) for name in robot_names()}
    tasks = {f"task/{name}": task_entry(name).task_type().__module__ for name in task_entries()}
    return scenarios | robots | tasks


def _module_of_robot(name: str) -> str:
    entry = robot_info(name)
    return (entry.part or (entry.build if isinstance(entry.build, str) else "")).partition(":")[0]


def touched_jobs(names: Mapping[str, str], changed: Iterable[str]) -> set[str]:
    """Return the jobs whose scenario, robot or task is defined in a module that changed."""
    modules = changed_modules(changed)
    return {name for name, module in names.items() if module in modules}


def commands(chosen: Iterable[str], names: Iterable[str], revision: Revision) -> list[tuple[str, list[str]]]:
    """Return the runs, each as a folder and the arguments of ``orbit conformance``.

    Scenarios run on every backend; on a backend whose plugin changed, all of them do.
    """
    by_kind: dict[str, list[str]] = defaultdict(list)
    for name in chosen:
        kind, _, own = name.partition("/")
        by_kind[kind].append(own)
    runs = [("scenarios", ["--quick", "--scenario", *by_kind["scenario"]])] if by_kind["scenario"] else []
    others = [f"--{kind}" for kind in ("robot", "task") if by_kind[kind]]
    if others:
        parts = [*(["robots"] if by_kind["robot"] else []), *(["tasks", "transfers"] if by_kind["task"] else [])]
        lists = [word for flag in others for word in (flag, *by_kind[flag.removeprefix("--")])]
        runs.append(("tasks", ["--quick", "--part", *parts, *lists, "--backend", *TASK_BACKENDS]))
    rest = [name.partition("/")[2] for name in names if name.startswith("scenario/")]
    rest = [name for name in rest if name not in by_kind["scenario"]]
    for backend in sorted(touched_backends(revision.changed) & {*backend_names()}):
        runs.append((f"scenarios-{backend}", ["--quick", "--backend", backend, "--scenario", *rest]))
    return [(folder, arguments) for folder, arguments in runs if arguments[-1] not in ("--scenario",)]


def measured_jobs(results: Iterable[Path]) -> dict[str, float]:
    """Return the seconds of each job over all its backends, from the ``result.json`` files of finished runs.

    A task's seconds are those of its expert, its replays and videos, and the policies that are kept for it.
    """
    seconds: dict[str, float] = defaultdict(float)
    for path in results:
        result = json.loads(path.read_text(encoding="utf-8"))
        task_of = {policy["name"]: policy["task"] for policy in result["header"]["policies"]}
        for record in result["records"]:
            kind, name = record["job"]["kind"], record["job"]["name"]
            kind = kind if kind in ("scenario", "robot") else "task"
            seconds[f"{kind}/{task_of.get(name, name)}"] += record["seconds"]
    return dict(seconds)
