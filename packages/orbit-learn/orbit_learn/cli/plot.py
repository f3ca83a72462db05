"""``orbit plot``: learning curves of trainings, against each other."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from tyro.conf import Positional, arg

from orbit_core.cli.output import console
from orbit_core.cli.settings import check_output, parse_words
from orbit_core.interfaces import ConfigurationError


@dataclass(frozen=True, kw_only=True)
class PlotSettings:
    """Draw the learning curves of trainings."""

    folders: Annotated[Positional[tuple[Path, ...]], arg(metavar="FOLDER")]
    """Folders of trainings."""
    number: Annotated[str, arg(metavar="NAME")] = "success_rate"
    """Number that is drawn: success_rate, episode_return, or a metric of the task."""
    output: Annotated[Path, arg(metavar="FILE")] = Path("out/curves.png")
    """Write the picture here, as PNG."""
    overwrite: bool = False
    """Replace the file if it is there already."""


def main(words: Sequence[str]) -> None:
    """Draw the curves, and print where the picture is."""
    from orbit_learn.curves import MOST_CURVES, curve_of, draw_curves

    settings = parse_words(PlotSettings, words, "orbit plot")
    if not 0 < len(settings.folders) <= MOST_CURVES:
        raise ConfigurationError(f"give one to {MOST_CURVES} folders of trainings, not {len(settings.folders)}")
    check_output(settings.output, ".png", settings.overwrite)
    curves = {}
    for folder in settings.folders:
        lines = curve_of(folder)
        if not lines:
            raise ConfigurationError(f"{folder} holds no training's curve.jsonl")
        if not any(settings.number in line or settings.number in line["metrics"] for line in lines):
            known = sorted({*lines[-1]} - {"metrics"} | {*lines[-1]["metrics"]})
            raise ConfigurationError(f"the curve of {folder} has no '{settings.number}': it has {', '.join(known)}")
        curves[str(folder)] = lines
    draw_curves(curves, settings.number, settings.output)
    console().print(f"{settings.output}", soft_wrap=True)
