"""Draw how trainings went: python tools/plot_training.py out/learning.png FOLDER ...

Folders whose names differ in a last ``_<seed>`` alone become one line: their mean, in a band from least to most.
Returns are given over the best of all whose names begin with the same word, which is the task's.
"""

from __future__ import annotations

import json
import re
import sys
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
import numpy.typing as npt

Curve = npt.NDArray[np.float64]
"""(iterations, 3): environment steps in millions, return, success in percent."""


def main(output: Path, folders: list[Path]) -> None:
    """Return and success over environment steps, a line a training or a group of seeds."""
    groups: dict[str, list[Curve]] = {}
    for folder in folders:
        groups.setdefault(re.sub(r"_\d+$", "", folder.name), []).append(_curve(folder))
    best: dict[str, float] = {}
    for name, curves in groups.items():
        best[_task(name)] = max(best.get(_task(name), -np.inf), *(np.nanmax(curve[:, 1]) for curve in curves))
    figure, both = plt.subplots(1, 2, figsize=(9.0, 3.4), layout="constrained")
    for name, curves in groups.items():
        values = np.stack([curve[: min(map(len, curves))] for curve in curves])
        values[..., 1] /= best[_task(name)]
        seeds = f", {len(curves)} seeds" if len(curves) > 1 else ""
        for column, axes in enumerate(both, start=1):
            steps, some = values[0, :, 0], values[..., column]
            (line,) = axes.plot(steps, some.mean(0), label=name + seeds)
            axes.fill_between(steps, some.min(0), some.max(0), color=line.get_color(), alpha=0.25, linewidth=0)
    for axes, name in zip(both, ("return over the best", "success, %"), strict=True):
        axes.set(xlabel="environment steps, millions", ylabel=name)
        axes.grid(alpha=0.3)
    both[0].set_ylim(-0.5, 1.1)
    figure.legend(*both[0].get_legend_handles_labels(), loc="outside lower center", ncols=4, frameon=False)
    figure.savefig(output, dpi=110)


def _task(name: str) -> str:
    return name.split(",")[0]


def _curve(folder: Path) -> Curve:
    lines = [json.loads(line) for line in (folder / "curve.jsonl").read_text().splitlines()]
    rows = [(line["env_steps"] / 1e6, line["episode_return"], line["success_rate"]) for line in lines]
    return np.array(rows, dtype=float) * (1.0, 1.0, 100.0)  # None, before an episode has ended, becomes NaN


if __name__ == "__main__":
    main(Path(sys.argv[1]), [Path(folder) for folder in sys.argv[2:]])
