"""``orbit check-task``: order of returns, limits kept by experts, coverage of starts, and chance, task by task."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from rich.text import Text
from tyro.conf import Positional, arg

from orbit_core.cli.output import console, new_table, progress_bar, write_json
from orbit_core.cli.settings import check_output, check_positive, parse_words
from orbit_core.envs.registry import task_entries, task_entry
from orbit_core.interfaces.errors import UnsupportedCapabilityError

if TYPE_CHECKING:
    from orbit_conformance.task_audit import TaskAudit


@dataclass(frozen=True, kw_only=True)
class CheckTaskSettings:
    """Check tasks: whether the expert earns more than random and zero actions and keeps its joints' limits, what area
    and angles the starts cover, and how often agents that look at nothing succeed. Exits with 1 where a check fails
    that the task does not declare, or a declared one holds."""

    task: Annotated[Positional[tuple[str, ...]], arg(metavar="TASK...")] = ()
    """Tasks; all if left out."""
    backend: str | None = None
    """Physics backend; may be left out if only one is installed."""
    episodes: int = 16
    """Episodes of each agent, one in each environment."""
    start_samples: int = 1024
    """Starts that are sampled."""
    seed: int = 0
    """Seed of the environments and agents."""
    device: Annotated[str, arg(metavar="NAME")] = "cpu"
    """Torch device that holds all state."""
    json: Path | None = None
    """Write the measurements there."""
    overwrite: bool = False
    """Replace the JSON file."""


def main(words: Sequence[str]) -> int:
    """Audit the tasks, print a table, and say by the exit code whether a check fails."""
    settings = parse_words(CheckTaskSettings, words, "orbit check-task")
    check_output(settings.json, ".json", settings.overwrite)
    check_positive("episodes", settings.episodes)
    check_positive("start_samples", settings.start_samples)
    names = settings.task or tuple(task_entries())
    for name in names:
        task_entry(name)
    from orbit_conformance.task_audit import audit_task

    audits: list[TaskAudit] = []
    refused: dict[str, str] = {}
    with progress_bar() as bar:
        for name in bar.track(names, description="tasks"):
            try:
                audit = audit_task(
                    name,
                    settings.backend,
                    episodes=settings.episodes,
                    start_samples=settings.start_samples,
                    seed=settings.seed,
                    device=settings.device,
                )
            except UnsupportedCapabilityError as error:
                refused[name] = str(error)
                continue
            audits.append(audit)
    write_json(settings.json, {"tasks": [values_of(audit) for audit in audits], "refused": refused})
    _print(audits, refused)
    return 1 if any(audit.faults for audit in audits) else 0


def values_of(audit: TaskAudit) -> dict[str, Any]:
    """Return everything measured of a task, for a JSON file."""
    values = asdict(audit)
    values["verdicts"] = [
        {"check": one.check.value, "status": one.status.value, "figure": one.figure, "reason": one.reason}
        for one in audit.verdicts
    ]
    return values


def _print(audits: Sequence[TaskAudit], refused: dict[str, str]) -> None:
    out = console()
    for audit in audits:
        head = f"{audit.episodes} episodes an agent on {audit.backend}, {audit.start_samples} starts"
        out.print(Text.assemble((audit.task, "bold"), f": {head}, {audit.seconds:.1f} s"))
        table = new_table("check", "", "measured", "reason")
        for one in audit.verdicts:
            table.add_row(one.check.value, one.status.value, Text(one.figure), Text(one.reason))
        out.print(table)
    for name, why in refused.items():
        out.print(Text.assemble((name, "bold"), f": refused, {why}"))
    failed = [audit.task for audit in audits if audit.faults]
    out.print(f"{len(audits)} tasks checked, {len(failed)} with faults" + (f": {', '.join(failed)}" if failed else ""))
