"""Page of a sweep: trials by their value, what each setting does to it, and the curves of the best."""

from __future__ import annotations

import base64
import io
from html import escape
from typing import Any

from orbit_learn.curves import curve_of, new_figure, number_of
from orbit_learn.evaluation.page import STYLE, table
from orbit_learn.sweep.plan import Range
from orbit_learn.sweep.running import Sweep, best_values

# Trials whose curves are drawn, and settings that get a picture.
_CURVES, _PICTURES = 8, 12


def page(sweep: Sweep) -> str:
    """Return the page as HTML, which needs no other file."""
    plan, options = sweep.plan, sweep.plan.options
    ranked = list(best_values(sweep))
    failed = [trial for trial in sweep.trials if trial.failures]
    population = options.search == "population"
    what = f"{'least' if options.minimize else 'largest'} {options.objective}"
    title = f"Sweep of {plan.train.task}"
    rows = [
        (
            str(trial.number),
            f"{value:.4g}",
            escape(", ".join(f"{each:.4g}" for each in trial.scores.values())),
            *(escape(_shown(trial.values[path])) for path in plan.vary),
            *([escape("; ".join(trial.copied))] if population else []),
        )
        for trial, value in ranked
    ]
    parts = [
        f"<h1>{escape(title)}</h1>",
        f"<p>Search {escape(options.search)} for the {escape(what)}: mean of the last {options.last} of "
        f"{plan.train.iterations} iterations, over {len(options.seeds)} seeds. {len(ranked)} of {len(sweep.trials)} "
        "trials have a value.</p>",
        "<h2>Trials, the best first</h2>",
        table(("trial", "value", "by seed", *map(escape, plan.vary), *(["copied"] if population else [])), rows),
    ]
    if ranked:
        parts += ["<h2>Settings</h2>", _picture(_settings_figure(sweep)) if plan.vary else "<p>Seeds alone vary.</p>"]
        parts += ["<h2>Curves of the best</h2>", _picture(_curves_figure(sweep))]
    if failed:
        failures = [
            (str(trial.number), escape(seed), escape(message))
            for trial in failed
            for seed, message in trial.failures.items()
        ]
        parts += ["<h2>Failed</h2>", table(("trial", "seed", "why"), failures)]
    return (
        f'<!doctype html><html lang="en"><meta charset="utf-8"><meta name="viewport" content="width=device-width">'
        f"<title>{escape(title)}</title><style>{STYLE}img{{max-width:100%}}</style><body>{''.join(parts)}</body></html>\n"
    )


def _settings_figure(sweep: Sweep) -> Any:
    """Draw the value over each varied setting."""
    plan, ranked = sweep.plan, list(best_values(sweep))
    paths = list(plan.vary)[:_PICTURES]
    columns = min(4, len(paths))
    rows = -(-len(paths) // columns)
    figure = new_figure(3.0 * columns + 0.5, 2.6 * rows)
    grid = figure.subplots(rows, columns, squeeze=False, sharey=True)
    for axis in grid.flat[len(paths) :]:
        axis.set_visible(False)
    for axis, path in zip(grid.flat, paths, strict=False):
        choices = plan.vary[path]
        values = [trial.values[path] for trial, _ in ranked]
        if isinstance(choices, Range):
            axis.set_xscale("log" if choices.log else "linear")
            axis.set_xlim(choices.low, choices.high)
            places = values
        else:
            # Evenly by place in the list: choices may be words or lists, which have no axis.
            places = [choices.index(value) for value in values]
            axis.set_xticks(range(len(choices)), labels=[_shown(each) for each in choices])
        axis.plot(places, [value for _, value in ranked], "o", markersize=5, alpha=0.7)
        axis.tick_params(axis="x", which="both", labelsize=7)
        axis.set_xlabel(path, fontsize=8)
        axis.grid(alpha=0.3)
    grid[0, 0].set_ylabel(plan.options.objective)
    return figure


def _curves_figure(sweep: Sweep) -> Any:
    """Draw the curves of the best trials, a line for each seed."""
    figure, plan = new_figure(9.0, 4.0), sweep.plan
    axis = figure.subplots()
    for place, (trial, _) in enumerate(list(best_values(sweep))[:_CURVES]):
        for index, seed in enumerate(plan.options.seeds):
            lines = curve_of(sweep.folder_of(trial, seed))
            points = [(line["env_steps"], number_of(line, plan.options.objective)) for line in lines]
            points = [point for point in points if point[1] is not None]
            axis.plot(
                [step for step, _ in points],
                [value for _, value in points],
                color=f"C{place}",
                linewidth=1.2,
                # Seeds of a trial share a colour, so that one entry of the legend names them all.
                label=f"trial {trial.number}" if index == 0 else None,
            )
    axis.set(xlabel="environment steps", ylabel=plan.options.objective)
    axis.legend(fontsize=8)
    axis.grid(alpha=0.3)
    return figure


def _picture(figure: Any) -> str:
    buffer = io.BytesIO()
    figure.savefig(buffer, dpi=120, format="png")
    return f'<img alt="" src="data:image/png;base64,{base64.b64encode(buffer.getvalue()).decode()}">'


def _shown(value: Any) -> str:
    return (
        f"{value:.4g}"
        if isinstance(value, float)
        else ", ".join(map(str, value))
        if isinstance(value, list)
        else str(value)
    )
