"""The report's plots, each from a result only."""

from __future__ import annotations

import io
import itertools
import math
import re
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np

from orbit_conformance.courses import Course
from orbit_conformance.execution import TRACES
from orbit_conformance.jobs import Kind
from orbit_conformance.results import Record, Result, ScenarioInfo, decode
from orbit_conformance.scenario import Metric, Trace
from orbit_conformance.throughput import Throughput
from orbit_core.interfaces.matter import NATIVE

mpl.use("agg")  # no window, even where the environment chooses an interactive backend

from matplotlib.figure import Figure

# Plots as small SVG for a page: text stays text, and no two plots share a name ----------------------------------------

STYLE: dict[Any, Any] = {
    "svg.fonttype": "none",
    "font.family": "sans-serif",
    "font.size": 8,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "grid.color": "#e3e3e3",
    "grid.linewidth": 0.6,
    "axes.titlesize": 8,
    "lines.linewidth": 1.3,
    "legend.frameon": False,
    "legend.fontsize": 7,
    "path.simplify_threshold": 0.5,
}
# Okabe and Ito's colours, which the colour-blind can distinguish; yellow is left out, as it is too pale on white.
COLORS = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#56b4e9", "#e69f00", "#000000")
PANEL_WIDTH, PANEL_HEIGHT = 2.7, 2.1
_COLUMNS = 4
# Columns of the legend below the panels.
_LEGEND_COLUMNS = 2


class Plot:
    """A grid of panels, with one legend for all."""

    def __init__(self, titles: Sequence[str]) -> None:
        columns = self._columns = min(_COLUMNS, len(titles))
        rows = -(-len(titles) // columns)
        self.figure = Figure(figsize=(PANEL_WIDTH * columns, PANEL_HEIGHT * rows + 0.3), layout="constrained")
        """Matplotlib's figure."""
        axes = self.figure.subplots(rows, columns, squeeze=False).ravel()
        for axis in axes[len(titles) :]:
            axis.remove()
        self.panels: dict[str, Any] = dict(zip(titles, axes, strict=False))
        """Axes by title."""
        for title, panel in self.panels.items():
            panel.set_title(title, loc="left")

    def svg(self, name: str) -> str:
        """The plot's markup; ``name`` is unique in the page."""
        handles: dict[str, Any] = {}
        for panel in self.panels.values():
            handles.update({label: handle for handle, label in zip(*panel.get_legend_handles_labels(), strict=True)})
        if handles:
            columns = min(len(handles), _LEGEND_COLUMNS * self._columns)
            self.figure.legend(handles.values(), handles.keys(), loc="outside lower left", ncols=columns)
        buffer = io.StringIO()
        with mpl.rc_context({**STYLE, "svg.hashsalt": name}):
            self.figure.savefig(buffer, format="svg", metadata={"Date": None}, transparent=True)
        return _slim(buffer.getvalue())


@contextmanager
def plotting(titles: Sequence[str]) -> Iterator[Plot]:
    """A plot with one panel a title, in the report's style."""
    with mpl.rc_context(STYLE):
        yield Plot(titles)


def color_of(name: str, names: Sequence[str]) -> str:
    """The colour of a name, the same in all plots."""
    return COLORS[names.index(name) % len(COLORS)]


def _slim(svg: str) -> str:
    """The markup without what only a separate file needs."""
    svg = svg[svg.index("<svg") :]
    svg = re.sub(r"<metadata>.*?</metadata>", "", svg, flags=re.DOTALL)
    svg = re.sub(r"<!--.*?-->", "", svg, flags=re.DOTALL)
    # Ids of many plots in one page would clash; nothing refers to these.
    svg = re.sub(r' id="[A-Za-z0-9.]+_\d+"', "", svg)
    svg = re.sub(r' (?:xmlns(?::xlink)?|version)="[^"]*"', "", svg)
    svg = svg.replace("xlink:href", "href")
    # A hundredth of a point is below a screen's resolution, and halves the page.
    svg = re.sub(r'\b(?:d|x|y|transform)="[^"]*"', lambda place: re.sub(r"(\.\d\d)\d+", r"\1", place[0]), svg)
    svg = re.sub(r"font-family: [^;\"]*", "", svg)  # the page's own
    svg = re.sub(r"\s*\n\s*(?=[A-Zz][ \"\d-])", " ", svg)  # a path's points on one line
    svg = re.sub(r"\s*\n\s*", "\n", svg)
    return _without_bare_groups(svg).replace("<svg ", '<svg aria-hidden="true" ', 1)


def _without_bare_groups(svg: str) -> str:
    """Drop groups without attributes; every tag must be on a separate line."""
    kept, open_groups = [], []
    for line in svg.splitlines():
        if line.startswith("<g"):
            open_groups.append(line != "<g>")
            bare = not open_groups[-1]
        else:
            bare = line == "</g>" and not open_groups.pop()
        if not bare:
            kept.append(line)
    return "\n".join(kept)


_MARGIN = 10**0.5
# Errors below are drawn here: a logarithmic axis has no zero.
_LEAST = 1e-9


def accuracy(result: Result, info: ScenarioInfo) -> str:
    """Error of each metric against speed, a line a backend over its time steps; empty if nothing was measured."""
    backends = result.header.settings.backends
    drawn = False
    with plotting([_title(metric) for metric in info.metrics]) as plot:
        for metric, panel in zip(info.metrics, plot.panels.values(), strict=True):
            for backend, matter in itertools.product(backends, result.matters(info.name)):
                points = _points(result.scenario_records(info.name, backend, matter), metric)
                nominal = _points([r for r in (result.nominal(info, backend, matter),) if r], metric)
                if not points:
                    continue
                drawn = True
                style = {"color": color_of(backend, backends), "label": _label(backend, matter)}
                panel.plot(*zip(*points, strict=True), _dash(matter), marker=".", **style)
                if nominal:
                    panel.plot(*zip(*nominal, strict=True), "o", color=style["color"])
            panel.axhline(max(metric.tolerance, _LEAST), color="#777", dashes=(3, 2), linewidth=0.9, label="tolerance")
            if panel.lines[:-1]:
                _logarithmic(panel)
            panel.set_xlabel("simulated s / s")
        return plot.svg(f"accuracy-{info.name}") if drawn else ""


def _points(records: list[Record], metric: Metric) -> list[tuple[float, float]]:
    """Speeds and errors of the records that have finite ones; without a solver's own choice where it has a sweep."""
    # A solver's own choice of step would be a point off the line of its sweep.
    swept = [record for record in records if record.job.substep] or records
    results = [record.scenario for record in swept if record.scenario]
    pairs = [(found.speed, found.errors.get(metric.name, math.nan)) for found in results]
    return [(speed, max(error, _LEAST)) for speed, error in pairs if math.isfinite(speed) and math.isfinite(error)]


def _label(backend: str, matter: str) -> str:
    return f"{backend}, {matter}" if matter else backend


def _dash(matter: str) -> str:
    return "--" if matter == NATIVE else "-"


def traces(result: Result, info: ScenarioInfo, folder: Path) -> str:
    """Draw measured curves and the truth; empty if the scenario keeps none, or their files are not there."""
    backends = result.header.settings.backends
    curves: dict[str, list[tuple[str, str, Trace]]] = {}
    for backend, matter in itertools.product(backends, result.matters(info.name)):
        record = result.nominal(info, backend, matter)
        path = folder / record.job.key / TRACES if record else None
        if path is not None and path.exists():
            for trace in decode(path.read_bytes(), list[Trace]):
                curves.setdefault(_title(trace), []).append((backend, matter, trace))
    if not curves:
        return ""
    with plotting(list(curves)) as plot:
        for title, panel in plot.panels.items():
            # All engines have the same truth, at the same times.
            truth = curves[title][0][2]
            panel.plot(truth.times, truth.truth, color="#bbb", linewidth=3.5, label="truth")
            for backend, matter, trace in curves[title]:
                style = {"color": color_of(backend, backends), "linewidth": 1, "label": _label(backend, matter)}
                panel.plot(trace.times, trace.measured, _dash(matter), **style)
            panel.set_xlabel("s")
        return plot.svg(f"traces-{info.name}")


def success(result: Result) -> str:
    """Rate of each task on each backend with its interval; empty without tasks."""
    backends, records = result.header.settings.backends, [r for r in result.of(Kind.TASK) if r.task]
    tasks = [task for task in result.header.settings.tasks if any(r.job.name == task for r in records)]
    if not tasks:
        return ""
    with plotting(tasks) as plot:
        for record in records:
            estimate = record.task.success if record.task else None
            assert estimate is not None
            row = backends.index(record.job.backend)
            panel, color = plot.panels[record.job.name], color_of(record.job.backend, backends)
            panel.plot([100 * estimate.low, 100 * estimate.high], [row, row], color=color, linewidth=2)
            panel.plot([100 * estimate.value], [row], "o", color=color)
        for panel in plot.panels.values():
            panel.set(xlim=(-3, 103), ylim=(len(backends) - 0.5, -0.5), xlabel="success (%)")
            panel.set_yticks(range(len(backends)), backends)
        return plot.svg("success")


def divergences(result: Result, task: str) -> str:
    """Median distance over time between each pair of backends, with its quartiles; empty if none was recorded."""
    pairs = [pair for pair in result.partings if pair.task == task]
    things = list(dict.fromkeys(thing.thing for pair in pairs for thing in pair.things))
    if not things:
        return ""
    with plotting(things) as plot:
        for index, pair in enumerate(pairs):
            color, label = COLORS[index % len(COLORS)], f"{pair.backend} - {pair.reference}"
            for thing in pair.things:
                panel = plot.panels[thing.thing]
                panel.plot(thing.times, thing.median, color=color, label=label)
                quartiles = (thing.lower_quartile, thing.upper_quartile)
                panel.fill_between(thing.times, *quartiles, color=color, alpha=0.12, linewidth=0)
        for panel in plot.panels.values():
            panel.set(xlabel="s", ylabel="m")
        return plot.svg(f"divergence-{task}")


def throughput(result: Result) -> str:
    """Environment steps per second over numbers of environments, the raw engine's dashed; empty if none measured."""
    backends = result.header.settings.backends
    rates: dict[str, dict[str, list[Throughput]]] = {}
    for record in result.of(Kind.THROUGHPUT):
        if record.throughput:
            rates.setdefault(record.job.name, {}).setdefault(record.job.backend, []).append(record.throughput)
    if not rates:
        return ""
    with plotting(list(rates)) as plot:
        for task, panel in plot.panels.items():
            for backend, measured in rates[task].items():
                measured.sort(key=lambda rate: rate.num_envs)
                counts, color = [rate.num_envs for rate in measured], color_of(backend, backends)
                own = [rate.env_steps_per_second for rate in measured]
                raw = [rate.raw.env_steps_per_second if rate.raw else math.nan for rate in measured]
                panel.plot(counts, own, "o-", markersize=3, color=color, label=backend)
                panel.plot(counts, raw, "--", color=color, linewidth=0.9)
            panel.set(xscale="log", yscale="log", xlabel="environments", ylabel="env. steps / s")
        return plot.svg("throughput")


def _logarithmic(panel: Any) -> None:
    """Axes around all that is drawn, wide enough to have a power of ten each, and marked there alone."""
    speeds = [speed for line in panel.lines[:-1] for speed in line.get_xdata()]  # the last is the tolerance
    errors = [error for line in panel.lines for error in line.get_ydata()]
    panel.set(xlim=(min(speeds) / _MARGIN, _MARGIN * max(speeds)), ylim=(min(errors) / _MARGIN, _MARGIN * max(errors)))
    panel.set(xscale="log", yscale="log")
    panel.minorticks_off()


def _title(quantity: Metric | Trace) -> str:
    return f"{quantity.name} ({quantity.unit})" if quantity.unit else quantity.name


# Share of the extent of all curves that is left free around them.
_COURSE_MARGIN = 0.05


def courses(result: Result, task: str) -> str:
    """A panel for each backend from above, one for each of heights, and one of the metric; empty without courses."""
    backends = result.header.settings.backends
    found = [course for course in result.courses if course.task == task]
    if not found:
        return ""
    points = list(found[0].points)
    metric = found[0].metric
    titles = [f"{course.backend}, {view} (m)" for view in ("from above", "height") for course in found]
    with plotting([*titles, metric]) as plot:
        for course in found:
            for index, point in enumerate(points):
                color, dash = COLORS[index % len(COLORS)], "-" if index < len(COLORS) else ":"
                style = {"color": color, "linestyle": dash, "linewidth": 1, "label": point.rpartition("/")[2]}
                x, y, z = np.array(course.points[point]).T
                above = plot.panels[f"{course.backend}, from above (m)"]
                above.plot(x, y, **style)
                above.plot(x[:1], y[:1], "o", markersize=3, color=color)
                plot.panels[f"{course.backend}, height (m)"].plot(course.times, z, **style)
            color = color_of(course.backend, backends)
            plot.panels[metric].plot(course.times, course.values, color=color, label=course.backend)
        _same_axes([plot.panels[f"{c.backend}, from above (m)"] for c in found], found, (0, 1))
        _same_axes([plot.panels[f"{c.backend}, height (m)"] for c in found], found, (2,))
        for title in (*titles[len(found) :], metric):
            plot.panels[title].set_xlabel("s")
        return plot.svg(f"courses-{task}")


def _same_axes(panels: Sequence[Any], found: Sequence[Course], columns: Sequence[int]) -> None:
    """The same limits for all panels, around these coordinates of all courses; the last is the vertical axis."""
    places = np.concatenate([np.array(list(course.points.values())).reshape(-1, 3) for course in found])
    for column, axis in zip(reversed(columns), ("y", "x"), strict=False):
        low, high = float(np.nanmin(places[:, column])), float(np.nanmax(places[:, column]))
        room = _COURSE_MARGIN * (high - low) + 1e-3
        for panel in panels:
            panel.set(**{f"{axis}lim": (low - room, high + room)})
