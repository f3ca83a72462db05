"""Choose a commit's share of the suite: fast jobs, a sixtieth of the slow ones, what the change concerns."""

from __future__ import annotations

import json
from collections import defaultdict
from collections.abc import Iterable, Mapping
from dataclasses import replace
from pathlib import Path

from orbit_assets.catalogue import robot_info, robot_names
from orbit_conformance.hardware import cores
from orbit_conformance.journal import LOG
from orbit_conformance.pools import LocalPool
from orbit_conformance.runner import run
from orbit_conformance.scenarios import SCENARIOS
from orbit_conformance.settings import choose
from orbit_core.backends import backend_names
from orbit_core.envs.registry import task_entries, task_entry
from tests.tiers.revision import Revision, current_revision
from tests.tiers.selection import select
from tests.tiers.slow_list import TURNS, read_slow_list
from tests.tiers.touched import changed_modules, touched_backends

OUTPUT = Path("out/conformance")
"""Folder of the runs of ``make test-all``, by which the slow list is refreshed."""
QUICK_OUTPUT = Path("out/conformance-quick")
TASK_BACKENDS = ("mujoco", "sapien")
"""Robots, tasks and policies run on two backends; ``orbit conformance`` is the whole matrix."""


def run_quick(output: Path = QUICK_OUTPUT) -> int:
    """Run this commit's share of the suite and return 1 if a backend is not as it declares, else 0."""
    revision = current_revision()
    # The first turns have the longest of their kind: jobs take turns from the last on, so that they do not meet tests.
    revision = replace(revision, turn=TURNS - 1 - revision.turn)
    listed = {name: seconds for name, seconds in read_slow_list().items() if "::" not in name}
    names = suite_names()
    known = {name: seconds for name, seconds in listed.items() if name in names}
    selection = select(known, revision, touched_jobs(names, revision.changed))
    chosen = [name for name in names if name not in known or name in selection.chosen]
    failed = False
    for folder, choice in runs(chosen, known, revision).items():
        folder = output / folder
        # Fresh, for what an interrupted run of another commit left there is of other jobs. No report: its plots take a
        # quarter of the time, and `orbit conformance report` makes it where a run failed.
        result = run(choose(quick=True, **choice), folder, LocalPool(cores(), 900.0, folder / LOG), fresh=True)
        print(f"{folder}: {len(result.judged)} jobs, {len(result.objections)} not as declared")
        for record in result.objections:
            print(f"{record.job.key}: {record.status.value}: {record.why}")
        failed |= bool(result.objections)
    print(f"conformance: {selection.describe(revision.turn)}")
    if gone := sorted({*listed} - {*names}):
        print(f"the slow list names {len(gone)} jobs that are gone (`make slow-list`): {gone[0]} ...")
    return int(failed)


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


def runs(
    chosen: Iterable[str], known: Mapping[str, float], revision: Revision
) -> dict[str, dict[str, tuple[str, ...]]]:
    """Return what each run chooses of the suite, by its folder.

    Scenarios run on every backend. Of a backend whose plugin changed the other scenarios run as well, of which those of
    the coming turns come first and take no longer than slow tests do that a change concerns.

    Args:
        chosen: names of this commit's jobs.
        known: seconds of each slow job over all its backends.
        revision: commit under test.
    """
    own = {
        kind: tuple(name for name in chosen if name.startswith(f"{kind}/")) for kind in ("scenario", "robot", "task")
    }
    parts = (("robots",) if own["robot"] else ()) + (("tasks", "transfers") if own["task"] else ())
    found: dict[str, dict[str, tuple[str, ...]]] = {}
    if own["scenario"]:
        found["scenarios"] = {"scenarios": _words(own["scenario"])}
    if parts:
        found["tasks"] = {"parts": parts, "backends": TASK_BACKENDS}
        found["tasks"] |= {f"{kind}s": _words(own[kind]) for kind in ("robot", "task") if own[kind]}
    everywhere = {*backend_names()}
    if touched := tuple(sorted(touched_backends(revision.changed) & everywhere)):
        part = len(touched) / len(everywhere)
        left = {n: part * s for n, s in known.items() if n.startswith("scenario/") and n not in own["scenario"]}
        if names := _words(sorted(select(left, revision, left).chosen)):
            found["scenarios-touched"] = {"scenarios": names, "backends": touched}
    return found


def _words(names: Iterable[str]) -> tuple[str, ...]:
    return tuple(name.partition("/")[2] for name in names)


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
