"""Plots of numbers over time on a page."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

# CSS pixels for the numbers at the vertical axis: uPlot's own 50 cut the sign off numbers such as -0.0005
_NUMBERS = 76.0


def add_plot(gui: Any, lines: Mapping[str, str], aspect: float) -> Any:
    """Add an empty plot of lines over time in seconds to a page.

    Args:
        gui: viser's interface of the page.
        lines: colour of each line by its name.
        aspect: width over height.

    Returns:
        Viser's handle, whose ``data`` are the times and each line's values.
    """
    from viser import uplot

    nothing = np.zeros(1)
    series = (uplot.Series(label=name, stroke=color, width=2) for name, color in lines.items())
    return gui.add_uplot(
        (nothing,) * (1 + len(lines)),
        (uplot.Series(label="s"), *series),
        scales={"x": uplot.Scale(time=False)},
        axes=(uplot.Axis(), uplot.Axis(size=_NUMBERS)),
        aspect=aspect,
    )
