r"""Yield of augmentation: attempts that succeed, by task, engine and method, from a few demonstrations.

    python benchmarks/imitation/yields.py --jobs 16 --attempts 128 --budget 560 --output out/yields
    python benchmarks/imitation/yields.py --output out/yields --page out/yields/table.md

``orbit record`` and ``orbit augment``, each in a process of one thread. The same command goes on where the budget
ended.
"""

from __future__ import annotations

import argparse
import re
import signal
import sys
from collections.abc import Sequence
from pathlib import Path

from work import Job, Ledger, run_jobs

from orbit_core.backends import backend_names
from orbit_core.files import written_whole
from orbit_core.rollout.estimates import proportion

_TASKS = ("Lift", "Cabinet", "Stack", "Stack-Pyramid", "Peg-In-Hole", "Jenga")
_METHODS = ("mimicgen", "skillgen")
_SOME = re.compile(r"(\d+) of (\d+) attempts")
_NONE = re.compile(r"none of (\d+) attempts")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--jobs", type=int, default=1, help="processes at a time")
    parser.add_argument("--tasks", nargs="+", default=list(_TASKS))
    parser.add_argument("--backends", nargs="+", default=None, help="all that are installed if left out")
    parser.add_argument("--recorded-on", default="mujoco", help="engine of the demonstrations")
    parser.add_argument("--demonstrations", type=int, default=10)
    parser.add_argument("--attempts", type=int, default=128)
    parser.add_argument("--budget", type=float, default=1e9, help="seconds of wall time")
    parser.add_argument("--output", type=Path, default=Path("out/yields"))
    parser.add_argument("--page", type=Path, help="write the table from what was run instead of running")
    arguments = parser.parse_args()
    logs = arguments.output / "logs"
    if arguments.page is not None:
        with written_whole(arguments.page) as written:
            written.write_text(table(logs))
        return
    arguments.output.mkdir(parents=True, exist_ok=True)
    kept = ("demonstrations", "attempts", "recorded_on")
    ledger = Ledger(arguments.output / "results.json", {name: getattr(arguments, name) for name in kept})
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(143))
    complete = run_jobs(yield_jobs(arguments), ledger, arguments.jobs, arguments.budget, logs, 0)
    print(table(logs))
    sys.exit(0 if complete else 75)


def yield_jobs(arguments: argparse.Namespace) -> list[Job]:
    """Return the recordings, and the augmentations that read them, named ``augment.task.engine.method``."""
    jobs: list[Job] = []
    for task in arguments.tasks:
        file = arguments.output / f"{task}.hdf5"
        # More than are cut, as some fail.
        episodes = 2 * arguments.demonstrations
        words = (
            "record", task, "--backend", arguments.recorded_on, "--num-envs", str(episodes), "--episodes",
            str(episodes), "--output", str(file), "--resume",
        )  # fmt: skip
        jobs.append(Job(f"record.{task}", lambda words=words: words))
        for engine in arguments.backends or backend_names():
            for method in _METHODS:
                output = arguments.output / f"{task}.{engine}.{method}.hdf5"
                words = (
                    "augment", str(file), "--output", str(output), "--backend", engine, "--method", method,
                    "--demonstrations", str(arguments.demonstrations), "--num-envs", str(arguments.attempts),
                    "--episodes", str(arguments.attempts), "--most-attempts", str(arguments.attempts), "--overwrite",
                )  # fmt: skip
                jobs.append(Job(f"augment.{task}.{engine}.{method}", lambda words=words: words, (f"record.{task}",)))
    return jobs


def table(logs: Path) -> str:
    """Return the yields that the logs of augmentations report, in Markdown; a row for each task and method."""
    found: dict[tuple[str, str], dict[str, str]] = {}
    for log in sorted(logs.glob("augment.*.log")):
        _, task, engine, method = log.stem.split(".")
        counted = _counted(" ".join(log.read_text().split()))
        if counted is not None:
            found.setdefault((task, method), {})[engine] = proportion(*counted).percent()
    engines = sorted({engine for row in found.values() for engine in row})
    lines = [_row(("task", "method", *engines)), "|---" * (2 + len(engines)) + "|"]
    lines += [_row((*key, *(row.get(engine, "not run") for engine in engines))) for key, row in found.items()]
    return "\n".join(lines) + "\n"


def _counted(text: str) -> tuple[int, int] | None:
    """Return successes and attempts, the last that a log names."""
    if some := _SOME.findall(text):
        return int(some[-1][0]), int(some[-1][1])
    none = _NONE.findall(text)
    return (0, int(none[-1])) if none else None


def _row(fields: Sequence[str]) -> str:
    return "| " + " | ".join(fields) + " |"


if __name__ == "__main__":
    main()
