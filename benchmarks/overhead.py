"""What ORBIT costs over the engine it wraps: a whole environment against raw stepping of the same native model.

    python benchmarks/overhead.py --task Lift --num-envs 64 --json overhead.json
    python benchmarks/overhead.py --sweep 1 4 16 64 256 1024 --plot overhead.png

The environment takes random actions and does all that it does in learning: actions to joint targets, physics,
observations, rewards, terminations, resets (episodes are staggered, so that some end in most blocks). After each block
of its steps, the raw stepper starts from the state that the block began in and takes the very commands that the
environment gave, so that both simulate the same motions and contacts; every way of stepping that the backend's plugin
offers in its module ``raw`` is tried, and the fastest is the yardstick. Blocks alternate, and the median of their
ratios counts.
"""

from __future__ import annotations

import importlib
import os
import statistics
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import torch
import tyro
from stopwatch import timed_parts

from orbit_core.backends import backend as find_backend
from orbit_core.backends import default_backend
from orbit_core.cli.agents import RandomAgent
from orbit_core.cli.checks import check_output
from orbit_core.cli.output import console, new_table, write_json
from orbit_core.cli.runner import versions_of
from orbit_core.tasks import Environment, make


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
    sweep: tuple[int, ...] = ()
    """Numbers of environments to measure at, in the place of ``num_envs``."""
    blocks: int = 16
    """Blocks of each kind."""
    block_steps: int = 50
    """Steps of all environments in a block."""
    seed: int = 0
    """Of the environments and of the actions."""
    json: Path | None = None
    """Write the figures here."""
    plot: Path | None = None
    """Draw the figures here, as PNG."""


@dataclass(frozen=True)
class Overhead:
    """Of one number of environments."""

    num_envs: int
    ratio: float
    """Environment's rate over the raw rate: median over the blocks."""
    ratio_quartiles: tuple[float, float]
    env_steps_per_second: float
    """Median over the blocks, environment steps of single environments."""
    raw_env_steps_per_second: float
    """The same of raw stepping, the fastest way."""
    raw: str
    """Which way of raw stepping was the fastest."""
    milliseconds_per_step: float
    raw_milliseconds_per_step: float
    parts_milliseconds: dict[str, float] = field(default_factory=dict)
    """Own time of each part in one step, by a stopwatch that itself costs some microseconds."""


def measure(settings: Settings, num_envs: int) -> Overhead:
    """Alternate blocks of the environment and of each raw stepper."""
    torch.set_num_threads(1)  # as the command line does: small tensors gain nothing, and the engine needs the cores
    fields: dict[str, Any] = {} if settings.action is None else {"action": settings.action}
    environment = make(settings.task, num_envs, settings.backend or default_backend(), seed=settings.seed, **fields)
    try:
        agent = RandomAgent(environment, settings.seed)
        raw = _raw_module(environment).raw_steppers(environment.world.engine)
        _stagger(environment, settings.seed)
        _block(environment, agent, raw, settings.block_steps)  # warm up
        blocks = [_block(environment, agent, raw, settings.block_steps) for _ in range(settings.blocks)]
        parts = _parts(environment, agent, settings.block_steps * max(1, settings.blocks // 4))
    finally:
        environment.close()
    medians = {name: statistics.median(block[name] for block in blocks) for name in blocks[0]}
    best = min(raw, key=lambda name: medians[name])
    ratios = sorted(block[best] / block[_ENVIRONMENT] for block in blocks)
    own, yardstick = medians[_ENVIRONMENT], medians[best]
    return Overhead(
        num_envs=num_envs,
        ratio=statistics.median(ratios),
        ratio_quartiles=(ratios[len(ratios) // 4], ratios[-1 - len(ratios) // 4]),
        env_steps_per_second=num_envs / own,
        raw_env_steps_per_second=num_envs / yardstick,
        raw=best,
        milliseconds_per_step=1e3 * own,
        raw_milliseconds_per_step=1e3 * yardstick,
        parts_milliseconds=parts,
    )


_ENVIRONMENT = "environment"


def _raw_module(environment: Environment) -> Any:
    """The module ``raw`` of the backend's package."""
    package = type(find_backend(environment.world.backend)).__module__.partition(".")[0]
    return importlib.import_module(f"{package}.raw")


def _stagger(environment: Environment, seed: int) -> None:
    """Let the first episodes be as if begun at any time, so that resets spread over all steps."""
    generator = torch.Generator().manual_seed(seed)
    steps = torch.randint(environment.max_episode_steps, (environment.num_envs,), generator=generator)
    environment.reset()
    environment.task.episode_step[:] = steps.to(environment.device)


def _block(environment: Environment, agent: RandomAgent, raw: dict[str, Any], steps: int) -> dict[str, float]:
    """Seconds per step of the environment and of each raw stepper, over the same stretch of motion."""
    actions = [agent.act() for _ in range(steps)]
    for stepper in raw.values():
        stepper.synchronize()
    recorder = next(iter(raw.values()))
    commands: list[Any] = []

    def step_environment(action: torch.Tensor) -> None:
        environment.step(action)
        commands.append(recorder.command())

    seconds = {_ENVIRONMENT: _seconds(step_environment, actions)}
    decimation = environment.task.decimation
    for name, stepper in raw.items():
        seconds[name] = _seconds(lambda command, stepper=stepper: stepper.step(command, decimation), commands)
    return {name: total / steps for name, total in seconds.items()}


def _seconds(function: Callable[[Any], None], arguments: list[Any]) -> float:
    start = time.perf_counter()
    for argument in arguments:
        function(argument)
    return time.perf_counter() - start


def _parts(environment: Environment, agent: RandomAgent, steps: int) -> dict[str, float]:
    """Milliseconds of one step by part."""
    with timed_parts(environment) as watch:
        for _ in range(steps):
            environment.step(agent.act())
    return {part: 1e3 * seconds / steps for part, seconds in sorted(watch.seconds.items(), key=lambda item: -item[1])}


def _print(figures: list[Overhead], title: str) -> None:
    table = new_table("environments", "ratio", "quartiles", "env. steps/s", "raw", "fastest raw way", title=title)
    for f in figures:
        quartiles = f"{f.ratio_quartiles[0]:.3f} to {f.ratio_quartiles[1]:.3f}"
        rates = f"{f.env_steps_per_second:,.0f}", f"{f.raw_env_steps_per_second:,.0f}"
        table.add_row(f"{f.num_envs:,}", f"{f.ratio:.3f}", quartiles, *rates, f.raw)
    console().print(table)
    parts = list(dict.fromkeys(part for f in figures for part in f.parts_milliseconds))
    table = new_table("ms per step", *(f"{f.num_envs:,} envs" for f in figures))
    for part in parts:
        table.add_row(part, *(f"{f.parts_milliseconds.get(part, 0.0):.4f}" for f in figures))
    console().print(table)


def _plot(figures: list[Overhead], title: str, path: Path) -> None:
    from matplotlib.figure import Figure

    figure = Figure(figsize=(9.6, 3.8), layout="constrained")
    rates, ratios = figure.subplots(1, 2)
    sizes = [f.num_envs for f in figures]
    rates.plot(sizes, [f.raw_env_steps_per_second for f in figures], marker="s", label="raw stepping")
    rates.plot(sizes, [f.env_steps_per_second for f in figures], marker="o", label="environment")
    rates.set(ylabel="environment steps per second", title=title)
    rates.legend()
    spread = [[f.ratio - f.ratio_quartiles[0] for f in figures], [f.ratio_quartiles[1] - f.ratio for f in figures]]
    ratios.errorbar(sizes, [f.ratio for f in figures], yerr=spread, marker="o", capsize=3)
    ratios.axhline(1.0, color="grey", linewidth=0.8)
    ratios.set(ylabel="environment / raw", title="ratio: median and quartiles of the blocks", ylim=(0.0, 1.1))
    for axes in (rates, ratios):
        axes.set(xscale="log", xlabel="environments")
        axes.set_xticks(sizes, labels=[str(size) for size in sizes])
        axes.set_xticks([], minor=True)
        axes.grid(alpha=0.3)
    rates.set_ylim(bottom=0.0)
    figure.savefig(path, dpi=150)


def main(settings: Settings) -> None:
    """Measure, print, write and draw."""
    check_output(settings.json, ".json")
    check_output(settings.plot, ".png")
    name = settings.backend or default_backend()
    figures = [measure(settings, num_envs) for num_envs in settings.sweep or (settings.num_envs,)]
    title = f"{settings.task} on {name}" + (f", {settings.action}" if settings.action else "")
    _print(figures, title)
    values = {
        "task": settings.task,
        "action": settings.action,
        "backend": name,
        "versions": versions_of(name),
        "cores": os.cpu_count(),
        "load": os.getloadavg(),
    }
    values["block_steps"], values["blocks"] = settings.block_steps, settings.blocks
    values["overhead"] = [asdict(figure) for figure in figures]
    if not settings.sweep:
        values["ratio"] = figures[0].ratio
    write_json(settings.json, values)
    if settings.plot is not None:
        _plot(figures, title, settings.plot)


if __name__ == "__main__":
    main(tyro.cli(Settings))
