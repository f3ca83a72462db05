"""Draw how trainings went: python tools/plot_training.py out/learning.png FOLDER ..."""

from __future__ import annotations

import json
import sys
from pathlib import Path

import matplotlib.pyplot as plt


def main(output: Path, folders: list[Path]) -> None:
    """Return and success over environment steps, a line a training."""
    figure, (returns, success) = plt.subplots(1, 2, figsize=(9.0, 3.2), layout="constrained")
    for folder in folders:
        lines = [json.loads(line) for line in (folder / "curve.jsonl").read_text().splitlines()]
        steps = [line["env_steps"] / 1e6 for line in lines]
        best = max(line["episode_return"] for line in lines if line["episode_return"] is not None)
        relative = [None if line["episode_return"] is None else line["episode_return"] / best for line in lines]
        returns.plot(steps, [float("nan") if value is None else value for value in relative], label=folder.name)
        rates = [line["success_rate"] for line in lines]
        success.plot(steps, [float("nan") if rate is None else 100.0 * rate for rate in rates], label=folder.name)
    for axes, name in ((returns, "return over the best"), (success, "success, %")):
        axes.set(xlabel="environment steps, millions", ylabel=name)
        axes.grid(alpha=0.3)
    returns.set_ylim(-0.5, 1.1)
    success.legend(frameon=False)
    figure.savefig(output, dpi=110)


if __name__ == "__main__":
    main(Path(sys.argv[1]), [Path(folder) for folder in sys.argv[2:]])
