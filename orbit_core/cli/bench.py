"""``orbit bench``: throughput over numbers of environments."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from rich.table import Table

from orbit_core.backends import versions_of
from orbit_core.cli.making import make_environment
from orbit_core.cli.output import console, new_table, progress_bar, write_json
from orbit_core.cli.settings import BenchSettings, check_output, check_positive, parse_settings
from orbit_core.envs.actors import scripted_actor
from orbit_core.files import written_whole
from orbit_core.installing import install_extra
from orbit_core.interfaces.errors import ConfigurationError

if TYPE_CHECKING:
    from orbit_core.envs.environment import Environment


@dataclass(frozen=True)
class Throughput:
    """Measurements of one number of environments."""

    num_envs: int
    """Number N of environments."""
    env_steps_per_second: float
    """Steps of single environments."""
    milliseconds_per_step: float
    """Time in which every environment makes one step."""
    peak_memory_mib: float | None
    """Largest resident size of the process so far, smaller numbers of environments included; None if unknown."""


def main(words: Sequence[str]) -> None:
    """Measure, print a table, and write and draw the figures."""
    settings = parse_settings(BenchSettings, words, "orbit bench")
    if settings.plot is not None:
        _require_plots()
    with progress_bar() as bar:
        task = bar.add_task("steps", total=settings.steps * len(settings.num_envs))
        backend, figures = bench(settings, lambda steps: bar.advance(task, steps))
    values = {
        "task": settings.task,
        "backend": backend,
        "steps": settings.steps,
        "seed": settings.seed,
        "versions": versions_of(backend),
        "throughput": [asdict(figure) for figure in figures],
    }
    write_json(settings.json, values)
    if settings.plot is not None:
        _plot(figures, f"{settings.task} on {backend}", settings.plot)
    console().print(_table(figures, f"{settings.task} on {backend}"))


def bench(
    settings: BenchSettings, progress: Callable[[int], None] = lambda steps: None
) -> tuple[str, list[Throughput]]:
    """Return the backend's name, and the throughput at each number of environments, ascending.

    Args:
        settings: what to measure.
        progress: called with the number of timed steps made since the last call.

    Raises:
        OrbitError: of many kinds; each names the setting.
    """
    check_positive("steps", settings.steps)
    check_output(settings.json, ".json", settings.overwrite)
    check_output(settings.plot, ".png", settings.overwrite)
    if not settings.num_envs:
        raise ConfigurationError("num_envs must name at least one number of environments")
    figures: list[Throughput] = []
    backend = ""
    # Ascending, because peak memory of the process never falls.
    for num_envs in sorted(set(settings.num_envs)):
        environment = make_environment(settings, num_envs)
        try:
            backend = environment.world.backend
            figures.append(_measure(environment, settings, progress))
        finally:
            environment.close()
    return backend, figures


def _measure(environment: Environment, settings: BenchSettings, progress: Callable[[int], None]) -> Throughput:
    agent = scripted_actor("random", environment, settings.seed)
    # Warm-up: first steps compile kernels and record graphs.
    for _ in range(max(1, settings.steps // 10)):
        environment.step(agent.act())
    # Drawn before the clock starts, so that only steps are timed.
    actions = [agent.act() for _ in range(16)]
    # In blocks, so that a progress bar can advance; waiting for the device between them costs little.
    seconds, block = 0.0, max(1, settings.steps // 20)
    for first in range(0, settings.steps, block):
        numbers = range(first, min(first + block, settings.steps))
        _wait(environment)
        start = time.perf_counter()
        for number in numbers:
            environment.step(actions[number % 16])
        _wait(environment)
        seconds += time.perf_counter() - start
        progress(len(numbers))
    steps, num_envs = settings.steps, environment.num_envs
    return Throughput(num_envs, num_envs * steps / seconds, 1e3 * seconds / steps, _peak_memory())


def _wait(environment: Environment) -> None:
    """Wait until a GPU has finished its work, which a step does not do."""
    if environment.device.type != "cpu":
        import torch

        torch.accelerator.synchronize(environment.device)


def _peak_memory() -> float | None:
    """Return the peak memory in MiB; None where the platform does not report it."""
    import sys

    try:
        import resource
    except ImportError:
        return None
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    # macOS reports bytes, Linux kibibytes.
    return peak / (2**20 if sys.platform == "darwin" else 2**10)


def _table(figures: list[Throughput], title: str) -> Table:
    table = new_table("environments", "env. steps/s", "ms per step", "peak memory (MiB)", title=title)
    for figure in figures:
        memory = "unknown" if figure.peak_memory_mib is None else f"{figure.peak_memory_mib:,.0f}"
        table.add_row(
            f"{figure.num_envs:,}",
            f"{figure.env_steps_per_second:,.0f}",
            f"{figure.milliseconds_per_step:.3g}",
            memory,
        )
    return table


def _require_plots() -> None:
    try:
        import matplotlib  # noqa: F401
    except ImportError as error:
        raise ConfigurationError(f"plots need matplotlib: {install_extra('plots')}") from error


def _plot(figures: list[Throughput], title: str, path: Path) -> None:
    from matplotlib.figure import Figure

    figure = Figure(figsize=(6.4, 4.0), layout="constrained")
    axes = figure.add_subplot()
    sizes = [point.num_envs for point in figures]
    axes.plot(sizes, [point.env_steps_per_second for point in figures], marker="o")
    axes.set(xscale="log", xlabel="environments", ylabel="environment steps per second", title=title)
    axes.set_xticks(sizes, labels=[str(size) for size in sizes], minor=False)
    axes.set_xticks([], minor=True)
    axes.set_ylim(bottom=0)
    axes.grid(alpha=0.3)
    with written_whole(path) as written:
        figure.savefig(written, dpi=150)
