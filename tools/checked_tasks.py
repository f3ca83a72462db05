"""Writes docs/measured/checked-tasks.md from the figures of `orbit check-task`.

orbit check-task --backend mujoco --json docs/figures/checked_tasks.json --overwrite
python tools/checked_tasks.py
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

DOCS = Path(__file__).parents[1] / "docs"
PAGE, FIGURES = DOCS / "measured" / "checked-tasks.md", DOCS / "figures" / "checked_tasks.json"
START, END = "<!-- checked tasks -->\n", "<!-- end -->"
MARKS = {"holds": "", "declared": " ≈", "fails": " ✗", "stale": " !", "not applicable": "–"}


def main() -> None:
    """Write the page."""
    figures = json.loads(FIGURES.read_text(encoding="utf-8"))
    PAGE.write_text(page(PAGE.read_text(encoding="utf-8"), figures), encoding="utf-8")


def page(text: str, figures: Mapping[str, Any]) -> str:
    """Return the page with its tables of these figures."""
    before, rest = text.split(START)
    return before + START + tables(figures["tasks"], figures["refused"]) + END + rest.split(END, 1)[1]


def tables(tasks: Sequence[Mapping[str, Any]], refused: Mapping[str, str]) -> str:
    """Return a row for each task with its figures, and a row for each exception with its reason."""
    checks = [verdict["check"] for verdict in tasks[0]["verdicts"]]
    lines = [f"| task | episodes | {' | '.join(checks)} | s |", f"|---|---|{'---|' * len(checks)}---|"]
    for task in tasks:
        cells = [f"{verdict['figure']}{MARKS[verdict['status']]}" for verdict in task["verdicts"]]
        lines.append(f"| {task['task']} | {task['episodes']} | {' | '.join(cells)} | {task['seconds']:.0f} |")
    reasons = [
        f"| {task['task']} | {verdict['check']} | {verdict['reason']} |"
        for task in tasks
        for verdict in task["verdicts"]
        if verdict["status"] == "declared"
    ]
    lines += ["", "| task | check that does not hold | reason |", "|---|---|---|", *reasons, ""]
    lines += [f"{name} was refused: {why}" for name, why in refused.items()]
    return "\n".join([*lines, f"On `{tasks[0]['backend']}`; episodes are of each agent.", ""])


if __name__ == "__main__":
    main()
