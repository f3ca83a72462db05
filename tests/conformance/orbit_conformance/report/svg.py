"""Plots as small SVG for a page: text stays text, and no two plots share a name."""

from __future__ import annotations

import io
import re
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import Any

import matplotlib as mpl

mpl.use("agg")  # no window, even where the environment chooses an interactive backend

from matplotlib.figure import Figure

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
        axes = self.figure.subplots(rows, columns, squeeze=False).ravel()
        for axis in axes[len(titles) :]:
            axis.remove()
        self.panels: dict[str, Any] = dict(zip(titles, axes, strict=False))
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
