"""Key points of deformables side by side: from above, their heights over time, and the task's metric."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from orbit_conformance.courses import Course
from orbit_conformance.report.svg import COLORS, color_of, plotting
from orbit_conformance.results import Result

# Share of the extent of all curves that is left free around them.
_MARGIN = 0.05


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
        room = _MARGIN * (high - low) + 1e-3
        for panel in panels:
            panel.set(**{f"{axis}lim": (low - room, high + room)})
