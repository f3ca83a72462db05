"""Learning curves of trainings: their files, and pictures of them."""

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from orbit_core.files import read_bytes, written_whole
from orbit_core.installing import install_extra
from orbit_core.interfaces import ConfigurationError
from orbit_data.tensor_file import parse_json
from orbit_learn.training import CURVE

# Curves that a picture shows in colours that differ enough.
MOST_CURVES = 20
_MOST_BYTES = 1 << 26
_BARS, _WIDTH = "▁▂▃▄▅▆▇█", 20


def number_of(line: Mapping[str, Any], name: str) -> float | None:
    """Return a number of a line of a curve, or a metric of it; None where it is missing."""
    value = line.get(name, line["metrics"].get(name))
    return float(value) if isinstance(value, int | float) else None


def curve_of(folder: Path) -> list[dict[str, Any]]:
    """Return the lines of a training's curve; empty where there is none.

    Raises:
        ConfigurationError: the file is no curve.
    """
    path = folder / CURVE
    if not path.exists():
        return []
    try:
        # A training that is being written, or was killed, may leave a partial last line.
        whole = [line for line in read_bytes(path, _MOST_BYTES).decode().splitlines(keepends=True) if line[-1] == "\n"]
        lines = [parse_json(line) for line in whole]
        return [{**line, "metrics": dict(line["metrics"]), "iteration": int(line["iteration"])} for line in lines]
    except (ValueError, TypeError, KeyError) as error:
        raise ConfigurationError(f"{path} is no curve of a training ({error})") from None


def new_figure(width: float, height: float) -> Any:
    """Return an empty figure of matplotlib.

    Raises:
        ConfigurationError: matplotlib is not installed.
    """
    try:
        from matplotlib.figure import Figure
    except ImportError as error:
        raise ConfigurationError(f"pictures of curves need matplotlib: {install_extra('plots')}") from error
    return Figure(figsize=(width, height), layout="constrained")


def draw_curves(curves: Mapping[str, Sequence[Mapping[str, Any]]], number: str, path: Path) -> None:
    """Draw a number of several trainings over environment steps and over seconds, as PNG.

    Args:
        curves: lines of each training's curve, by the name in the legend.
        number: ``success_rate``, ``episode_return`` or a metric.
        path: file that is written.
    """
    figure = new_figure(10.0, 4.0)
    figure.set_layout_engine("constrained")
    axes = figure.subplots(1, 2, sharey=True)
    for name, lines in curves.items():
        found = [(line, number_of(line, number)) for line in lines]
        points = [(line, value) for line, value in found if value is not None]
        for axis, key in zip(axes, ("env_steps", "seconds"), strict=True):
            axis.plot([line[key] for line, _ in points], [value for _, value in points], label=name, linewidth=1.2)
    axes[0].set(xlabel="environment steps", ylabel=number.replace("_", " "))
    axes[1].set(xlabel="seconds of collecting and learning")
    for axis in axes:
        axis.grid(alpha=0.3)
    axes[1].legend(loc="center left", bbox_to_anchor=(1.0, 0.5), fontsize=8)
    with written_whole(path) as written:
        figure.savefig(written, dpi=150, format="png")


def sparkline(values: Sequence[float]) -> str:
    """Return a curve as one line of text, from its least to its greatest value; NaN are left out.

    Args:
        values: of all iterations so far; more than fit are averaged in groups.
    """
    known = [value for value in values if not math.isnan(value)]
    width = min(_WIDTH, len(known))
    edges = [len(known) * column // width for column in range(width + 1)] if known else []
    means = [sum(known[begin:end]) / (end - begin) for begin, end in itertools.pairwise(edges)]
    least, span = min(means, default=0.0), max(means, default=0.0) - min(means, default=0.0)
    return "".join(_BARS[round((value - least) / span * (len(_BARS) - 1)) if span else 0] for value in means)
