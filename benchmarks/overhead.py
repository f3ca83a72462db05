"""What ORBIT costs over the engine it wraps: a whole environment against raw stepping of the same native model.

    python benchmarks/overhead.py --task Lift --num-envs 64 --json overhead.json
    python benchmarks/overhead.py --sweep 1 4 16 64 256 1024 --plot overhead.png

:mod:`orbit_conformance.throughput` says how it is measured.
"""

from __future__ import annotations

import os
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import tyro

from orbit_conformance.throughput import Throughput, measure_once
from orbit_core.backends import default_backend, versions_of
from orbit_core.cli.output import console, new_table, write_json
from orbit_core.cli.settings import check_output
from orbit_core.files import written_whole


@dataclass(frozen=True, kw_only=True)
class Settings:
    """Measure a whole environment against raw stepping of the same native model."""

    task: str = "Lift"
    """Name of the task."""
    action: str | None = None
    """Name of the action space; the task's own if None."""
    backend: str | None = None
    """Name of the backend; may be left out if only one is installed."""
    num_envs: int = 64
    """Environments stepped together."""
    compile: bool = True
    """Whether to compile the environment's step, as one would for learning."""
    sweep: tuple[int, ...] = ()
    """Numbers of environments to measure at, in the place of ``num_envs``."""
    blocks: int = 16
    """Blocks of each kind."""
    block_steps: int = 50
    """Most steps of all environments in a block; fewer where they would take more than 1.5 s."""
    seed: int = 0
    """Of the environments and of the actions."""
    json: Path | None = None
    """Write the figures here."""
    plot: Path | None = None
    """Draw the figures here, as PNG."""
    overwrite: bool = False
    """Replace files of those names that are there already."""


def measure(settings: Settings, num_envs: int) -> Throughput:
    """Of one number of environments, in this process."""
    backend = settings.backend or default_backend()
    fields: dict[str, Any] = {} if settings.action is None else {"action": settings.action}
    return measure_once(
        settings.task, backend, num_envs, settings.blocks, settings.block_steps, settings.seed, fields,
        compile=settings.compile,
    )  # fmt: skip


def _print(figures: list[Throughput], title: str) -> None:
    table = new_table("environments", "ratio", "quartiles", "env. steps/s", "raw", "fastest raw way", title=title)
    for f in figures:
        rate = f"{f.env_steps_per_second:,.0f}"
        if f.raw is None:
            table.add_row(f"{f.num_envs:,}", "", "", rate, "", "no native baseline")
            continue
        quartiles = f"{f.raw.ratio_quartiles[0]:.3f} to {f.raw.ratio_quartiles[1]:.3f}"
        table.add_row(
            f"{f.num_envs:,}", f"{f.raw.ratio:.3f}", quartiles, rate, f"{f.raw.env_steps_per_second:,.0f}", f.raw.way
        )
    console().print(table)
    parts = list(dict.fromkeys(part for f in figures for part in f.parts_milliseconds))
    table = new_table("ms per step", *(f"{f.num_envs:,} envs" for f in figures))
    for part in parts:
        table.add_row(part, *(f"{f.parts_milliseconds.get(part, 0.0):.4f}" for f in figures))
    console().print(table)


def _plot(figures: list[Throughput], title: str, path: Path) -> None:
    from matplotlib.figure import Figure

    figure = Figure(figsize=(9.6, 3.8), layout="constrained")
    rates, ratios = figure.subplots(1, 2)
    sizes = [f.num_envs for f in figures]
    raw = [f.raw for f in figures if f.raw is not None]
    if len(raw) == len(figures):
        rates.plot(sizes, [f.env_steps_per_second for f in raw], marker="s", label="raw stepping")
        spread = [[f.ratio - f.ratio_quartiles[0] for f in raw], [f.ratio_quartiles[1] - f.ratio for f in raw]]
        ratios.errorbar(sizes, [f.ratio for f in raw], yerr=spread, marker="o", capsize=3)
    rates.plot(sizes, [f.env_steps_per_second for f in figures], marker="o", label="environment")
    rates.set(ylabel="environment steps per second", title=title)
    rates.legend()
    ratios.axhline(1.0, color="grey", linewidth=0.8)
    ratios.set(ylabel="environment / raw", title="ratio: median and quartiles of the blocks", ylim=(0.0, 1.1))
    for axes in (rates, ratios):
        axes.set(xscale="log", xlabel="environments")
        axes.set_xticks(sizes, labels=[str(size) for size in sizes])
        axes.set_xticks([], minor=True)
        axes.grid(alpha=0.3)
    rates.set_ylim(bottom=0.0)
    with written_whole(path) as written:
        figure.savefig(written, dpi=150)


def main(settings: Settings) -> None:
    """Measure, print, write and draw."""
    check_output(settings.json, ".json", settings.overwrite)
    check_output(settings.plot, ".png", settings.overwrite)
    name = settings.backend or default_backend()
    figures = [measure(settings, num_envs) for num_envs in settings.sweep or (settings.num_envs,)]
    title = f"{settings.task} on {name}" + (f", {settings.action}" if settings.action else "")
    _print(figures, title)
    values = {
        "task": settings.task,
        "action": settings.action,
        "backend": name,
        "compile": settings.compile,
        "versions": versions_of(name),
        "cores": os.cpu_count(),
        "load": os.getloadavg(),
    }
    values["block_steps"], values["blocks"] = settings.block_steps, settings.blocks
    values["overhead"] = [asdict(figure) for figure in figures]
    write_json(settings.json, values)
    if settings.plot is not None:
        _plot(figures, title, settings.plot)


if __name__ == "__main__":
    main(tyro.cli(Settings))
