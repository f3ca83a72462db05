"""``orbit run``: a task's episodes, and how they went."""

from __future__ import annotations

from collections.abc import Sequence

from rich.table import Table

from orbit_core.cli.output import console, new_table, progress_bar, write_json
from orbit_core.cli.parsing import parse_settings
from orbit_core.cli.runner import RunResult, run
from orbit_core.cli.settings import RunSettings
from orbit_core.rollout.estimates import Statistic

_TOLD_SHARE = 0.01
"""Of looks at what hands are asked for, how many must find it out of reach for the table to tell."""


def main(words: Sequence[str]) -> None:
    """Run what the words of the command line say."""
    show_run(parse_settings(RunSettings, words, "orbit run"))


def show_run(settings: RunSettings) -> None:
    """Run the episodes, print a table and write the result."""
    with progress_bar() as bar:
        counting = bar.add_task(f"{settings.task} episodes", total=settings.episodes)
        filming = bar.add_task("video, %", total=100, visible=settings.video is not None)

        def show(episodes: int, filmed: float) -> None:
            bar.update(counting, completed=episodes)
            bar.update(filming, completed=round(100.0 * filmed))

        result = run(settings, show)
    write_json(settings.json, result.as_json())
    console().print(_table(result))


def _table(result: RunResult) -> Table:
    title = f"{result.task} on {result.backend}: {result.robot}, {result.action}, {result.agent} agent"
    table = new_table("", "value", title=title)
    table.add_row("episodes", f"{result.episodes} in {result.num_envs} environments, seed {result.seed}")
    table.add_row("success rate", result.success_rate.percent())
    for name, metric in result.metrics.items():
        table.add_row(name, _words(metric))
    for check in result.premises:
        if check.failed:
            told = f"fails in {check.failed} of {check.starts} sampled starts: {check.reason}"
            table.add_row(f"premise '{check.name}'", told)
    if result.out_of_reach >= _TOLD_SHARE:
        told = f"in {100.0 * result.out_of_reach:.0f} % of looks, by up to {result.farthest_out_of_reach:.2f} m"
        table.add_row("poses asked for out of reach", told)
    table.add_row("return", _words(result.episode_return))
    table.add_row("episode steps", _words(result.episode_steps))
    table.add_row("environment steps per second", f"{result.env_steps_per_second:,.0f}")
    table.add_row("wall time", f"{result.wall_seconds:.1f} s")
    table.add_row("versions", ", ".join(f"{name} {version}" for name, version in result.versions.items()))
    return table


def _words(statistic: Statistic) -> str:
    return f"{statistic.mean:.4g} ± {statistic.deviation:.3g}"
