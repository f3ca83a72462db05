"""Searches: the combinations that a sweep tries, and how a population changes."""

from __future__ import annotations

import itertools
import random
from collections.abc import Iterator, Mapping, Sequence
from typing import Any, Protocol

from orbit_core.installing import install_extra
from orbit_core.interfaces import ConfigurationError
from orbit_learn.sweep.plan import Choices, Range, SweepPlan, Values


class Search(Protocol):
    """Source of combinations."""

    def ask(self, number: int, known: Values | None) -> Values | None:
        """Return the values of a trial by its number, in order from 0; None when there are no more.

        Args:
            number: of the trial.
            known: values that an earlier call of the command gave to it; None for a new trial.
        """
        ...

    def tell(self, number: int, value: float | None) -> None:
        """Take in the value of a trial that :meth:`ask` gave; None where it failed."""
        ...


class Listed(Search):
    """Combinations that are known from the first: a grid, or random draws."""

    def __init__(self, combinations: Sequence[Values]) -> None:
        self._combinations = combinations

    def ask(self, number: int, known: Values | None) -> Values | None:
        return self._combinations[number] if number < len(self._combinations) else None

    def tell(self, number: int, value: float | None) -> None:
        pass


class Tpe(Search):
    """Tree-structured Parzen estimator of Optuna: Akiba et al., Optuna (2019)."""

    def __init__(self, plan: SweepPlan) -> None:
        try:
            import optuna  # pyright: ignore[reportMissingImports]
        except ImportError as error:
            raise ConfigurationError(f"search tpe needs Optuna: {install_extra('sweep')}") from error
        # Optuna writes a line for each trial, into those of the command.
        optuna.logging.set_verbosity(optuna.logging.WARNING)
        sampler = optuna.samplers.TPESampler(seed=plan.options.seed)
        direction = "minimize" if plan.options.minimize else "maximize"
        self._study: Any = optuna.create_study(sampler=sampler, direction=direction)
        self._failed: Any = optuna.trial.TrialState.FAIL
        self._plan = plan
        self._asked: dict[int, Any] = {}

    def ask(self, number: int, known: Values | None) -> Values | None:
        if number >= self._plan.options.trials:
            return None
        if known is not None:
            # The next trial gets these values, so that the estimator learns from earlier calls too.
            self._study.enqueue_trial({path: self._named(path, value) for path, value in known.items()})
        trial = self._asked[number] = self._study.ask()
        return {path: self._suggested(trial, path, choices) for path, choices in self._plan.vary.items()}

    def tell(self, number: int, value: float | None) -> None:
        failed = {"state": self._failed} if value is None else {"values": value}
        self._study.tell(self._asked[number], **failed)

    def _named(self, path: str, value: Any) -> Any:
        """Return a value by the name that Optuna has for it."""
        choices = self._plan.vary[path]
        return value if isinstance(choices, Range) else [*choices].index(value)

    def _suggested(self, trial: Any, path: str, choices: Choices) -> Any:
        if not isinstance(choices, Range):
            # By place: Optuna compares choices, and lists of a file cannot be keys.
            return choices[trial.suggest_categorical(path, range(len(choices)))]
        if choices.whole:
            return trial.suggest_int(path, round(choices.low), round(choices.high), log=choices.log)
        return trial.suggest_float(path, choices.low, choices.high, log=choices.log)


def search_of(plan: SweepPlan) -> Search:
    """Return the search of a plan.

    Raises:
        ConfigurationError: it needs a library that is not installed.
    """
    if plan.options.search == "tpe":
        return Tpe(plan)
    if plan.options.search == "grid":
        lists: Any = plan.vary.values()
        return Listed([dict(zip(plan.vary, each, strict=True)) for each in itertools.product(*lists)])
    return Listed([*_drawn(plan)])


def _drawn(plan: SweepPlan) -> Iterator[Values]:
    for number in range(plan.options.trials):
        # A generator for each trial, so that more trials leave the first ones as they are.
        generator = random.Random(f"{plan.options.seed}/{number}")
        yield {
            path: choices.drawn(generator) if isinstance(choices, Range) else generator.choice(choices)
            for path, choices in plan.vary.items()
        }


def changed(values: Values, vary: Mapping[str, Choices], generator: random.Random) -> Values:
    """Return values that differ some: numbers by a factor, others drawn again."""
    return {
        path: choices.changed(values[path], generator) if isinstance(choices, Range) else generator.choice(choices)
        for path, choices in vary.items()
    }
