"""Random actions for a long time: nothing may fail, no number may be infinite or NaN, memory may not grow.

    python benchmarks/soak.py --task Lift Reach --steps 100000 --num-envs 64 --json soak.json

Without ``--task`` it takes every task. The exit code is 1 if a task fails.
"""

from __future__ import annotations

import sys
import time
from dataclasses import asdict, dataclass
from pathlib import Path

import psutil
import torch
import tyro
from rich.progress import Progress

from orbit_core.backends import default_backend, versions_of
from orbit_core.cli.output import console, new_table, progress_bar, write_json
from orbit_core.cli.settings import check_output
from orbit_core.envs import Environment, make, task_entries
from orbit_core.envs.actors import RandomActor
from orbit_core.interfaces import OrbitError


@dataclass(frozen=True, kw_only=True)
class Settings:
    """Take random actions for a long time and watch for failures, NaN and growing memory."""

    task: tuple[str, ...] = ()
    """Names of tasks; all if left out."""
    backend: str | None = None
    """Name of the backend; may be left out if only one is installed."""
    steps: int = 100_000
    """Actions of single environments, per task."""
    num_envs: int = 64
    """Environments stepped together."""
    seed: int = 0
    """Of the environments and of the actions."""
    max_growth_mib: float = 16.0
    """More growth of resident memory than this, from a tenth of the way to the end, is a failure."""
    json: Path | None = None
    """Write the report here."""
    overwrite: bool = False
    """Replace files of those names that are there already."""


@dataclass(frozen=True)
class Report:
    """Of one task."""

    task: str
    actions: int
    episodes: int
    seconds: float
    growth_mib: float
    resident_mib: float
    failure: str
    """Empty if there was none."""


class Soak:
    """One task's run."""

    def __init__(self, settings: Settings, task: str, environment: Environment) -> None:
        self._settings, self._task, self._environment = settings, task, environment
        self._agent = RandomActor(environment, settings.seed)
        self._memory = psutil.Process().memory_info
        self._actions = self._episodes = 0

    def run(self, bar: Progress) -> Report:
        """Step to the end or to the first failure."""
        steps = -(-self._settings.steps // self._environment.num_envs)
        tracker = bar.add_task(self._task, total=steps)
        start = time.perf_counter()
        failure, before = "", self._memory().rss
        for step in range(steps):
            failure = self._step()
            if failure:
                break
            if step == steps // 10:  # allocators and caches have warmed up
                before = self._memory().rss
            bar.advance(tracker)
        resident = self._memory().rss
        growth = (resident - before) / 2**20
        if not failure and growth > self._settings.max_growth_mib:
            failure = f"memory grew by {growth:.1f} MiB"
        seconds = time.perf_counter() - start
        return Report(self._task, self._actions, self._episodes, seconds, growth, resident / 2**20, failure)

    def _step(self) -> str:
        """One step of all environments; what went wrong, if anything did."""
        try:
            observation, reward, _, _, info = self._environment.step(self._agent.act())
        except OrbitError as error:
            return f"after {self._actions} actions: {error}"
        self._actions += self._environment.num_envs
        if "final" in info:
            self._episodes += len(info["final"].env_ids)
        for name, values in {**observation, "reward": reward}.items():
            if not bool(torch.isfinite(values).all()):
                return f"after {self._actions} actions: {name} is not finite"
        return ""


def main(settings: Settings) -> int:
    """Run each task, print a table and write the report; the exit code."""
    torch.set_num_threads(1)
    check_output(settings.json, ".json", settings.overwrite)
    backend = settings.backend or default_backend()
    reports: list[Report] = []
    with progress_bar() as bar:
        for task in settings.task or tuple(task_entries()):
            environment = make(task, settings.num_envs, backend, seed=settings.seed)
            try:
                reports.append(Soak(settings, task, environment).run(bar))
            finally:
                environment.close()
    table = new_table("task", "actions", "episodes", "seconds", "memory (MiB)", "growth (MiB)", "failure")
    for r in reports:
        numbers = (
            f"{r.actions:,}",
            f"{r.episodes:,}",
            f"{r.seconds:.0f}",
            f"{r.resident_mib:.0f}",
            f"{r.growth_mib:.1f}",
        )
        table.add_row(r.task, *numbers, r.failure or "none")
    console().print(table)
    values = {"backend": backend, "num_envs": settings.num_envs, "seed": settings.seed}
    write_json(settings.json, {**values, "versions": versions_of(backend), "tasks": [asdict(r) for r in reports]})
    return int(any(report.failure for report in reports))


if __name__ == "__main__":
    sys.exit(main(tyro.cli(Settings)))
