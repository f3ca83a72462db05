"""Runs a sweep: begins trainings, judges their curves, and keeps what is done for a command that goes on."""

from __future__ import annotations

import json
import random
import shutil
from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

from orbit_core.configuration import from_plain
from orbit_core.files import read_bytes, written_whole
from orbit_core.interfaces import ConfigurationError
from orbit_data.tensor_file import parse_json
from orbit_learn.curves import curve_of, number_of
from orbit_learn.sweep.cluster import Cluster, Part, run_all
from orbit_learn.sweep.plan import SweepPlan, Values
from orbit_learn.sweep.search import changed, search_of

RESULTS = "sweep.json"
_MOST_BYTES = 1 << 26


@dataclass
class Trial:
    """Combination of settings, and what came of its trainings."""

    number: int
    """Place in the order of the search, from 0."""
    values: dict[str, Any]
    """Values of the varied settings; a population's are those of its last interval."""
    scores: dict[str, float] = field(default_factory=dict)
    """Value of the objective by seed, of the trainings that ended."""
    failures: dict[str, str] = field(default_factory=dict)
    """Message by seed, of the trainings that failed."""
    copied: list[str] = field(default_factory=list)
    """A line for each exchange of a population: the iteration, and the trial that was copied."""

    def value(self, seeds: int) -> float | None:
        """Return the mean over all seeds; None where one is missing."""
        return sum(self.scores.values()) / seeds if len(self.scores) == seeds else None


@dataclass
class Sweep:
    """Sweep in its folder: ``sweep.json``, and a training's folder ``trial_<number>/seed_<seed>`` for each.

    Args:
        plan: the plan.
        folder: the folder; where it holds a sweep of the same plan, that goes on.

    Raises:
        ConfigurationError: the folder holds something else.
    """

    plan: SweepPlan
    folder: Path

    def __post_init__(self) -> None:
        self.trials: list[Trial] = []
        self._generation = 0
        self._described = _described(self.plan)
        if (self.folder / RESULTS).exists():
            self._read()
        elif self.folder.is_dir() and any(self.folder.iterdir()):
            raise ConfigurationError(f"{self.folder} holds other files: name another folder for the sweep")
        else:
            self.folder.mkdir(parents=True, exist_ok=True)
            self._write()

    @property
    def ranked(self) -> list[Trial]:
        """Trials that have a value, the best first."""
        seeds, sign = len(self.plan.options.seeds), -1.0 if self.plan.options.minimize else 1.0
        valued = [trial for trial in self.trials if trial.value(seeds) is not None]
        return sorted(valued, key=lambda trial: -sign * (trial.value(seeds) or 0.0))

    def run(self, cluster: Cluster, report: Callable[[Trial], None]) -> None:
        """Run what is not done yet.

        Args:
            cluster: where trainings run.
            report: called for each training that ends.
        """
        if self.plan.options.search == "population":
            self._run_population(cluster, report)
        else:
            self._run_search(cluster, report)

    def folder_of(self, trial: Trial, seed: int) -> Path:
        """Return the folder of a training."""
        return self.folder / f"trial_{trial.number:03d}" / f"seed_{seed}"

    def _part(self, trial: Trial, seed: int, until: int) -> Part:
        settings = self.plan.settings(trial.values, seed)
        return Part(trial.number, settings, self.folder_of(trial, seed).absolute(), until)

    def _run_search(self, cluster: Cluster, report: Callable[[Trial], None]) -> None:
        options, search, whole = self.plan.options, search_of(self.plan), self.plan.train.iterations or 0
        waiting: list[Part] = []
        # Combinations of an earlier call first: the search gives the same ones, and learns what came of them.
        asked, open_seeds, exhausted = 0, {}, False
        while True:
            # No more than can start: an estimator asked later has learned from more trials.
            while not exhausted and cluster.free > len(waiting):
                values = search.ask(asked, self.trials[asked].values if asked < len(self.trials) else None)
                if values is None:
                    exhausted = True
                    break
                trial = self._trial(asked, values)
                asked += 1
                missing = [seed for seed in options.seeds if str(seed) not in trial.scores]
                open_seeds[trial.number] = len(missing)
                waiting += [self._part(trial, seed, whole) for seed in missing]
                if not missing:
                    search.tell(trial.number, trial.value(len(options.seeds)))
            while waiting and cluster.free > 0:
                cluster.start(waiting.pop(0))
            if exhausted and not waiting and cluster.free == cluster.slots:
                return
            for part, failure in cluster.finished():
                trial = self.trials[part.trial]
                self._judge(trial, part, failure)
                report(trial)
                open_seeds[trial.number] -= 1
                if not open_seeds[trial.number]:
                    search.tell(trial.number, trial.value(len(options.seeds)))

    def _run_population(self, cluster: Cluster, report: Callable[[Trial], None]) -> None:
        options, search, whole = self.plan.options, search_of(self.plan), self.plan.train.iterations or 0
        for number in range(options.trials):
            self._trial(number, search.ask(number, None) or {})
        ends = [*range(options.interval, whole, options.interval), whole]
        for generation in range(self._generation, len(ends)):
            until = ends[generation]
            parts = [
                self._part(trial, seed, until)
                for trial in self.trials
                for seed in options.seeds
                if _iterations(self.folder_of(trial, seed)) < until
            ]
            for part, failure in run_all(cluster, parts):
                trial = self.trials[part.trial]
                self._judge(trial, part, failure)
                report(trial)
            if until < whole:
                self._exchange(until)
            self._generation = generation + 1
            self._write()

    def _exchange(self, iteration: int) -> None:
        """Give the worst quarter of a population the trainings of the best, with other settings from here on."""
        ranked = self.ranked
        # Populations of two and three exchange one trial, though a quarter of them is none.
        count = len(ranked) // 4 or int(len(ranked) > 1)
        # By seed and iteration, so that a command that was interrupted here exchanges the same trials when repeated.
        generator = random.Random(f"{self.plan.options.seed}/{iteration}")
        for trial in ranked[len(ranked) - count :]:
            source = generator.choice(ranked[:count])
            for seed in self.plan.options.seeds:
                # Whole or not at all: half a copy would pass for a training that goes on.
                with written_whole(self.folder_of(trial, seed)) as copy:
                    shutil.copytree(self.folder_of(source, seed), copy)
            trial.values = changed(source.values, self.plan.vary, generator)
            trial.scores = dict(source.scores)
            trial.copied.append(f"after {iteration} iterations: trial {source.number}")

    def _trial(self, number: int, values: Values) -> Trial:
        """Return a trial of an earlier call, or a new one."""
        if number == len(self.trials):
            self.trials.append(Trial(number, values))
            self._write()
        return self.trials[number]

    def _judge(self, trial: Trial, part: Part, failure: str) -> None:
        seed = str(part.settings.seed)
        # Failed trainings run again when the command is repeated; what an earlier call said of them is out of date.
        trial.failures.pop(seed, None)
        found = None if failure else score(part.folder, self.plan)
        if found is None:
            trial.failures[seed] = failure or f"no episode ended in the last {self.plan.options.last} iterations"
        else:
            trial.scores[seed] = found
        self._write()

    def _write(self) -> None:
        document = {
            "plan": self._described,
            "generation": self._generation,
            "trials": [asdict(trial) for trial in self.trials],
        }
        with written_whole(self.folder / RESULTS) as path:
            path.write_text(json.dumps(document, indent=1), encoding="utf-8")

    def _read(self) -> None:
        path = self.folder / RESULTS
        try:
            document = parse_json(read_bytes(path, _MOST_BYTES).decode())
            plan, trials, self._generation = document["plan"], document["trials"], int(document["generation"])
        except (ValueError, TypeError, KeyError) as error:
            raise ConfigurationError(f"{path} is no file of a sweep ({error})") from None
        if plan != self._described:
            different = [name for name in self._described if plan.get(name) != self._described[name]]
            raise ConfigurationError(
                f"{self.folder} holds a sweep with another {' and '.join(different)}: name another folder, or give the "
                "file that it was begun with"
            )
        self.trials = [from_plain(Trial, each, f"trial of {path}") for each in trials]


def score(folder: Path, plan: SweepPlan) -> float | None:
    """Return the objective's mean over the last iterations of a training; None where no episode has ended.

    Raises:
        ConfigurationError: the curve has no such number.
    """
    name, lines = plan.options.objective, curve_of(folder)
    found = [number_of(line, name) for line in lines[-plan.options.last :]]
    if lines and not any(name in line or name in line["metrics"] for line in lines):
        known = sorted({key for line in lines for key in (*_CURVE_NUMBERS, *line["metrics"])})
        raise ConfigurationError(f"a training of the sweep has no number '{name}': it has {', '.join(known)}")
    numbers = [value for value in found if value is not None]
    return sum(numbers) / len(numbers) if numbers else None


_CURVE_NUMBERS = ("success_rate", "episode_return", "loss")


def _iterations(folder: Path) -> int:
    lines = curve_of(folder)
    return lines[-1]["iteration"] + 1 if lines else 0


def _described(plan: SweepPlan) -> dict[str, Any]:
    """Return what must be the same where a sweep goes on, as JSON has it; numbers of trials and machines may change."""
    options = {name: value for name, value in asdict(plan.options).items() if name not in ("trials", "cpus", "gpus")}
    vary = {path: asdict(each) if not isinstance(each, tuple) else each for path, each in plan.vary.items()}
    described = {"options": options, "training": asdict(plan.train), "settings to vary": vary}
    # Through JSON, since tuples and paths come back from the file as lists and words.
    return json.loads(json.dumps(described, default=str))


def best_values(sweep: Sweep) -> Iterator[tuple[Trial, float]]:
    """Yield the trials that have a value with it, the best first."""
    for trial in sweep.ranked:
        value = trial.value(len(sweep.plan.options.seeds))
        if value is not None:
            yield trial, value
