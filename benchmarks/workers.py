"""Time of an environment's step by the number of worker processes that a backend divides the environments over.

    python benchmarks/workers.py --backend sapien --num-envs 64 --workers 1 2 4 8 16 --json workers.json

All numbers of workers are built at once, and blocks of their steps alternate, so that the ratios of the blocks tell
even where other programs use the machine. Processor time is of this process and its workers, all together.
"""

from __future__ import annotations

import os
import statistics
import time
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import torch
import tyro

from orbit_core.backends import versions_of
from orbit_core.cli.output import console, new_table, write_json
from orbit_core.cli.settings import check_output
from orbit_core.envs import Environment, make
from orbit_core.envs.actors import RandomActor


@dataclass(frozen=True, kw_only=True)
class Settings:
    """Time an environment's step by the number of worker processes."""

    task: str = "Lift"
    """Name of the task."""
    backend: str = "sapien"
    """Name of a backend with a setting ``workers``."""
    num_envs: int = 64
    """Environments stepped together."""
    workers: tuple[int, ...] = (1, 2)
    """Numbers of processes; the first is what the others are compared with."""
    settings: Mapping[str, int] = field(default_factory=dict)
    """Other settings of the backend, such as ``envs_per_world 1``."""
    blocks: int = 12
    """Blocks of each number of processes."""
    block_steps: int = 20
    """Steps of all environments in a block."""
    compile: bool = False
    """Compile the environment's step, as a training does."""
    seed: int = 0
    """Seed of the environments and of the actions."""
    json: Path | None = None
    """Write the figures here."""
    overwrite: bool = False
    """Replace a file of that name that is there already."""


@dataclass(frozen=True)
class Figures:
    """Times of one number of processes."""

    workers: int
    """The setting."""
    processes: int
    """Worker processes; 0 where this process steps."""
    milliseconds_per_step: float
    """Median over the blocks."""
    processor_milliseconds_per_step: float
    """Processor time of all processes together, median over the blocks."""
    speed: float
    """Speed as a multiple of the first number's: median over the blocks."""
    start_seconds: float
    """Time to build the environments."""
    memory_mib: float
    """Memory of the workers, each page's share of it."""


class Subject:
    """Environments with one number of processes."""

    def __init__(self, settings: Settings, workers: int) -> None:
        begin = time.perf_counter()
        own = {**settings.settings, "workers": workers}
        self.environment: Environment = make(
            settings.task, settings.num_envs, settings.backend, seed=settings.seed, settings=own,
            compile=settings.compile,
        )  # fmt: skip
        self.start = time.perf_counter() - begin
        self.actor = RandomActor(self.environment, settings.seed)
        self.pids: list[int] = getattr(self.environment.world.engine.native, "pids", [])

    def block(self, steps: int) -> tuple[float, float]:
        """Return seconds of wall and processor time of some steps."""
        begin, used = time.perf_counter(), self._used()
        for _ in range(steps):
            self.environment.step(self.actor.act())
        return time.perf_counter() - begin, self._used() - used

    def _used(self) -> float:
        ticks = sum(sum(map(int, _stat(pid)[11:13])) for pid in self.pids)
        return time.process_time() + ticks / os.sysconf("SC_CLK_TCK")

    @property
    def memory(self) -> float:
        """Memory of the workers in MiB."""
        lines = [line for pid in self.pids for line in Path(f"/proc/{pid}/smaps_rollup").read_text().splitlines()]
        return sum(int(line.split()[1]) for line in lines if line.startswith("Pss:")) / 1024.0


def _stat(pid: int) -> list[str]:
    """The fields of a process after its name."""
    return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()


def measure(settings: Settings) -> list[Figures]:
    """Measure all numbers of processes, by alternating blocks."""
    torch.set_num_threads(1)
    subjects = [Subject(settings, workers) for workers in settings.workers]
    blocks: list[list[tuple[float, float]]] = [[] for _ in subjects]
    for subject in subjects:
        subject.block(settings.block_steps)
    for _ in range(settings.blocks):
        for subject, own in zip(subjects, blocks, strict=True):
            own.append(subject.block(settings.block_steps))
    each = 1e3 / settings.block_steps
    found = [
        Figures(
            workers, len(subject.pids),
            each * statistics.median(wall for wall, _ in own), each * statistics.median(used for _, used in own),
            statistics.median(first / wall for (first, _), (wall, _) in zip(blocks[0], own, strict=True)),
            subject.start, subject.memory,
        )
        for workers, subject, own in zip(settings.workers, subjects, blocks, strict=True)
    ]  # fmt: skip
    for subject in subjects:
        subject.environment.close()
    return found


def main(settings: Settings) -> None:
    """Measure, print and write."""
    check_output(settings.json, ".json", settings.overwrite)
    figures = measure(settings)
    title = f"{settings.task} on {settings.backend}, {settings.num_envs} environments"
    columns = "workers", "processes", "ms per step", "processor ms", "speed", "start, s", "workers' MiB"
    table = new_table(*columns, title=title)
    for f in figures:
        wall, used = f"{f.milliseconds_per_step:.2f}", f"{f.processor_milliseconds_per_step:.2f}"
        rest = f"{f.speed:.2f}", f"{f.start_seconds:.1f}", f"{f.memory_mib:.0f}"
        table.add_row(str(f.workers), str(f.processes), wall, used, *rest)
    console().print(table)
    written: dict[str, Any] = {
        "task": settings.task, "backend": settings.backend, "versions": versions_of(settings.backend),
        "num_envs": settings.num_envs, "settings": dict(settings.settings), "cores": os.cpu_count(),
        "load": os.getloadavg(), "workers": [asdict(figure) for figure in figures],
    }  # fmt: skip
    write_json(settings.json, written)


if __name__ == "__main__":
    main(tyro.cli(Settings))
