r"""Leave one engine out: policies taught on some engines, and evaluated on one that they have not seen.

    python benchmarks/learning/leave_one_out.py --jobs 80 --seeds 2 --budget 880 --output out/leave-one-out
    python benchmarks/learning/leave_one_out.py --output out/leave-one-out --page out/leave-one-out/table.md
    python benchmarks/learning/leave_one_out.py --jobs 2 --tasks Stack --engines mujoco sapien --envs 4 --iterations 2 \
        --length 1 --episodes 2 --output out/leave-one-out-small

Each task is taught by its expert (``orbit train --library distill --teacher expert``) in as many environment steps
each time: on all engines but one together, on each engine, and on each engine with ``domain_randomization=true``, which
draws friction, gains and noise. Every policy then has episodes from the same starts on every engine
(``orbit evaluate``), nothing drawn. Jobs are processes of one thread, but for engines that step in several. The same
command goes on where the budget ended; its settings and results are in ``results.json`` of the output folder.
"""

from __future__ import annotations

import argparse
import json
import signal
import sys
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).parents[1] / "imitation"))  # of whose scripts the runner of jobs is

from table2 import continued, outcomes  # pyright: ignore[reportMissingImports]
from work import Job, Ledger, run_jobs  # pyright: ignore[reportMissingImports]

from orbit_core.files import written_whole
from orbit_core.rollout.estimates import proportion

_FIRST_START = 10_000
"""Seed of the starts of evaluation, which no training began with."""
_STUDENT = ("hidden_sizes=[256,128,64]", "buffer_size=600000", "batch_size=1024", "updates_per_iteration=24")


@dataclass(frozen=True)
class Taught:
    """A task, and how long it is taught."""

    name: str
    length: float
    """Seconds of an episode."""
    iterations: int
    """Number of iterations, each of 16 steps of every environment."""


TASKS = (Taught("Peg-In-Hole", 10.0, 160), Taught("Stack", 8.0, 150), Taught("Reach", 4.0, 30))
# Setting of an engine's processes or threads, and how many a training takes where it is the only one; as many as make
# trainings on all engines about as long. An engine that is not named steps in the process itself.
_PROCESSES = {"mujoco": ("threads", 1), "sapien": ("workers", 2), "bullet": ("workers", 3)}


@dataclass(frozen=True)
class Kind:
    """A training: on which engines, and whether physics is drawn."""

    engines: tuple[str, ...]
    drawn: bool = False

    @property
    def name(self) -> str:
        return f"{'drawn' if self.drawn else 'on'}-{'-'.join(self.engines)}"

    @property
    def told(self) -> str:
        """Its name in the page."""
        return ", ".join(self.engines) + (", drawn" if self.drawn else "")

    def words(self) -> tuple[str, ...]:
        """Words of ``orbit train`` for engines and their processes."""
        several = len(self.engines) > 1
        words = ["--backend", *self.engines]
        for engine in self.engines:
            if engine in _PROCESSES:
                key, count = _PROCESSES[engine]
                place = f"{engine}." if several else ""
                words += ["--setting", f"{place}{key}={min(count, 2) if several else count}"]
        return (*words, "--set", f"domain_randomization={str(self.drawn).lower()}")

    @property
    def cores(self) -> int:
        """Cores that it takes: of several engines, which step in turn, as many as the most does."""
        counts = [_PROCESSES.get(engine, ("", 1))[1] for engine in self.engines]
        return min(max(counts), 2) if len(counts) > 1 else counts[0]


def kinds(engines: Sequence[str]) -> list[Kind]:
    """Return the trainings of a task, those across engines first; with two engines there is none."""
    left = [Kind(tuple(other for other in engines if other != out)) for out in engines] if len(engines) > 2 else []
    return [*left, *(Kind((engine,)) for engine in engines), *(Kind((engine,), True) for engine in engines)]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--jobs", type=int, default=1, help="cores that are used at a time")
    names = [task.name for task in TASKS]
    parser.add_argument("--tasks", nargs="+", default=names, choices=names)
    parser.add_argument("--engines", nargs="+", default=["mujoco", "sapien", "bullet"])
    parser.add_argument("--seeds", type=int, default=1, help="trainings of each kind")
    parser.add_argument("--envs", type=int, default=48, help="environments of a training, over all its engines")
    parser.add_argument("--iterations", type=int, help="of each training; the task's own if left out")
    parser.add_argument("--length", type=float, help="seconds of an episode; the task's own if left out")
    parser.add_argument("--episodes", type=int, default=50, help="of each policy on each engine")
    parser.add_argument("--budget", type=float, default=1e9, help="seconds of wall time")
    parser.add_argument("--output", type=Path, default=Path("out/leave-one-out"))
    parser.add_argument("--page", type=Path, help="write the tables from the results instead of running")
    arguments = parser.parse_args()
    results = arguments.output / "results.json"
    if arguments.page is None:
        arguments.output.mkdir(parents=True, exist_ok=True)
        kept = ("engines", "envs", "iterations", "length", "episodes")
        ledger = Ledger(results, {name: getattr(arguments, name) for name in kept})
        signal.signal(signal.SIGTERM, lambda *_: sys.exit(143))
        jobs = study_jobs(arguments)
        complete = run_jobs(jobs, ledger, arguments.jobs, arguments.budget, arguments.output / "logs", 0)
        print(page(json.loads(results.read_text())))
        sys.exit(0 if complete else 75)
    with written_whole(arguments.page) as written:
        written.write_text(page(json.loads(results.read_text())))


def study_jobs(arguments: argparse.Namespace) -> list[Job]:
    """Return trainings ``train.TASK.KIND.SEED`` and evaluations ``evaluate.TASK.KIND.SEED.ENGINE``, by seed."""
    tasks = [task for task in TASKS if task.name in arguments.tasks]
    jobs: list[Job] = []
    for seed in range(arguments.seeds):
        for task in tasks:
            for kind in kinds(arguments.engines):
                jobs += _jobs_of(task, kind, seed, arguments)
    return jobs


def _jobs_of(task: Taught, kind: Kind, seed: int, arguments: argparse.Namespace) -> list[Job]:
    label = f"{task.name}.{kind.name}.{seed}"
    folder = arguments.output / label
    iterations = arguments.iterations or task.iterations
    words = (
        "train", task.name, "--library", "distill", "--teacher", "expert", *kind.words(),
        "--action", "ik_relative", "--set", "expert_starts=0",
        "--set", f"episode_length={arguments.length or task.length}",
        "--num-envs", str(arguments.envs), "--iterations", str(iterations), "--save-every", "20", "--seed", str(seed),
        *(word for setting in _STUDENT for word in ("--distillation", setting)),
    )  # fmt: skip
    trained = f"train.{label}"
    jobs = [Job(trained, lambda: (*words, *continued(folder, iterations)), leaves=folder, cores=kind.cores)]
    for engine in arguments.engines:
        key, cores = _PROCESSES.get(engine, ("", 1))
        into = arguments.output / f"evaluation.{label}.{engine}"
        evaluated = (
            "evaluate", str(folder), "--backend", engine, "--set", "domain_randomization=false",
            *(("--setting", f"{key}={cores}") if key else ()), "--episodes", str(arguments.episodes),
            "--seed", str(_FIRST_START), "--jobs", "1", "--output", str(into),
        )  # fmt: skip

        def read(into: Path = into) -> list[dict[str, object]]:
            return outcomes(into / "results.jsonl")

        name = f"evaluate.{label}.{engine}"
        jobs.append(Job(name, lambda words=evaluated: words, (trained,), read, cores=cores))
    return jobs


@dataclass
class _Count:
    successes: int = 0
    trials: int = 0

    def text(self) -> str:
        """Return successes with Wilson's interval of 95 % in hundredths; empty if nothing was evaluated."""
        if not self.trials:
            return "not run"
        rate = proportion(self.successes, self.trials)
        return f"{self.successes} of {self.trials} [{100 * rate.low:.0f}, {100 * rate.high:.0f}]"


def page(results: Mapping[str, Any]) -> str:
    """Return the tables of a file of results, in Markdown: on engines left out, and every policy on every engine."""
    engines, counts = results["settings"]["engines"], _counts(results["jobs"])
    tasks = list(dict.fromkeys(task for task, *_ in counts))

    def total(task: str, trained: Iterable[Kind], engine: str) -> str:
        several = [counts.get((task, kind.name, engine), _Count()) for kind in trained]
        return _Count(sum(each.successes for each in several), sum(each.trials for each in several)).text()

    lines = [
        "| task | left out | taught on the others together | on one of the others | on one, physics drawn |",
        "|---|---|---|---|---|",
    ]
    for task in tasks:
        for out in engines:
            others = tuple(other for other in engines if other != out)
            groups = [Kind(others)], [Kind((o,)) for o in others], [Kind((o,), True) for o in others]
            lines.append(_row((task, out, *(total(task, group, out) for group in groups))))
    lines += ["", _row(("task", "taught on", *engines)), "|---" * (2 + len(engines)) + "|"]
    for task in tasks:
        for kind in kinds(engines):
            cells = [total(task, [kind], engine) + (" (left out)" * (engine not in kind.engines)) for engine in engines]
            lines.append(_row((task, kind.told, *cells)))
    return "\n".join(lines) + "\n"


def _counts(jobs: Mapping[str, Any]) -> dict[tuple[str, str, str], _Count]:
    """Return counts over seeds by task, kind and engine."""
    counts: dict[tuple[str, str, str], _Count] = {}
    for name, done in jobs.items():
        what, task, kind, *_, engine = name.split(".")
        if what == "evaluate" and done["ended"]:
            count = counts.setdefault((task, kind, engine), _Count())
            for each in done["result"]:
                count.successes += each["successes"]
                count.trials += each["trials"]
    return counts


def _row(fields: Iterable[str]) -> str:
    return "| " + " | ".join(fields) + " |"


if __name__ == "__main__":
    main()
