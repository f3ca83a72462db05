"""``orbit sweep``: many trainings with varied settings, on a Ray cluster."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from tyro.conf import Positional, arg

from orbit_core.cli.output import console, new_table, progress_bar
from orbit_core.cli.settings import File, parse_words
from orbit_core.files import written_whole

PAGE = "sweep.html"


@dataclass(frozen=True, kw_only=True)
class SweepSettings:
    """Train with varied settings, and compare."""

    plan: Annotated[Positional[Path], arg(metavar="FILE")]
    """TOML file of the sweep."""
    output: File = None
    """Folder of the sweep; out/sweep/<name of the file> if left out. A sweep that it holds goes on."""
    ray: Annotated[str, arg(metavar="ADDRESS")] = "local"
    """Address of a Ray cluster; 'local' starts one on this machine, which ends with the command."""


def main(words: Sequence[str]) -> None:
    """Run a sweep with a progress bar, and write its page."""
    run(parse_words(SweepSettings, words, "orbit sweep"))


def run(settings: SweepSettings) -> None:
    """Run a sweep.

    Raises:
        OrbitError: of many kinds; each names the key or the setting.
    """
    from orbit_learn.sweep.cluster import Cluster
    from orbit_learn.sweep.page import page
    from orbit_learn.sweep.plan import read_plan
    from orbit_learn.sweep.running import Sweep, Trial, best_values

    plan = read_plan(settings.plan)
    sweep = Sweep(plan, settings.output or Path("out/sweep") / settings.plan.stem)
    cluster = Cluster(settings.ray, plan.options.cpus, plan.options.gpus)
    try:
        with progress_bar() as bar:
            line = bar.add_task(f"{plan.train.task}, {cluster.slots} at a time", total=None)

            def show(trial: Trial) -> None:
                best = next(best_values(sweep), None)
                shown = "" if best is None else f": best {best[1]:.4g} of trial {best[0].number}"
                bar.update(line, advance=1, description=f"{plan.train.task}, {cluster.slots} at a time{shown}")

            sweep.run(cluster, show)
    finally:
        cluster.close()
        # Also where the sweep was interrupted: what is done can be looked at.
        with written_whole(sweep.folder / PAGE) as path:
            path.write_text(page(sweep), encoding="utf-8")
    table = new_table("trial", plan.options.objective, *plan.vary, title=f"Sweep of {plan.train.task}")
    for trial, value in list(best_values(sweep))[:10]:
        table.add_row(str(trial.number), f"{value:.4g}", *(str(trial.values[path]) for path in plan.vary))
    console().print(table)
    failed = sum(bool(trial.failures) for trial in sweep.trials)
    if failed:
        console().print(f"{failed} of {len(sweep.trials)} trials have trainings that failed; the page says why")
    console().print(f"{sweep.folder / PAGE}", soft_wrap=True)
