"""The file of a sweep: what every training has, what varies, and how values are searched."""

from __future__ import annotations

import math
import random
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, TypeAlias

from orbit_core.cli.settings import COMMAND_LINE_ONLY
from orbit_core.configuration import configured, field_types, from_plain, read_toml
from orbit_core.interfaces import ArgumentError, ConfigurationError, OrbitError, UnknownNameError
from orbit_learn.cli.train import TrainSettings, check_training

SEARCHES = ("grid", "random", "tpe", "population")
# Options of `orbit train` that take key=value words, and tables of its file; a varied path may name a key of them.
_WORDS, _TABLES = ("ppo", "off_policy", "imitation", "distillation"), ("fields", "settings", "matter_settings")
# Settings that a training restores from its checkpoint, so that a population cannot change them on the way.
_IN_CHECKPOINT = ("learning_rate", "hidden_sizes", "critic_sizes", "initial_std", "temperature")
# Factors by which a population changes a number; Jaderberg et al., Population Based Training of Neural Networks (2017).
_FACTORS = (0.8, 1.25)


@dataclass(frozen=True, kw_only=True)
class Range:
    """Interval of numbers to draw from."""

    low: float
    """Smallest number."""
    high: float
    """Largest number."""
    log: bool = False
    """Whether logarithms are drawn uniformly, for settings whose order of magnitude matters."""
    whole: bool = False
    """Whether numbers are rounded to integers."""

    def __post_init__(self) -> None:
        if not (math.isfinite(self.low) and self.low < self.high < math.inf):
            raise ArgumentError(f"a range goes from low to high, not from {self.low:g} to {self.high:g}")
        if self.log and self.low <= 0.0:
            raise ArgumentError(f"a logarithmic range begins above zero, not at {self.low:g}")

    def drawn(self, generator: random.Random) -> float:
        """Draw a number."""
        low, high = (math.log(self.low), math.log(self.high)) if self.log else (self.low, self.high)
        value = generator.uniform(low, high)
        return self.rounded(math.exp(value) if self.log else value)

    def changed(self, value: float, generator: random.Random) -> float:
        """Return a number that is some larger or smaller, within the range."""
        return self.rounded(min(max(value * generator.choice(_FACTORS), self.low), self.high))

    def rounded(self, value: float) -> float:
        """Return a number, rounded where the range has whole ones."""
        return round(value) if self.whole else value


Values: TypeAlias = dict[str, Any]
"""Value of each varied setting, by its path."""
Choices: TypeAlias = tuple[Any, ...] | Range
"""What a varied setting may be."""


@dataclass(frozen=True, kw_only=True)
class SweepOptions:
    """Keys of a sweep's file, but for its tables."""

    search: str = "grid"
    """grid (all combinations), random, tpe (Optuna's estimator) or population (settings change on the way)."""
    trials: int = 0
    """Number of combinations to try, or size of the population; a grid has its own."""
    seeds: tuple[int, ...] = (0,)
    """Seeds that each combination is trained with; its value is their mean."""
    objective: str = "success_rate"
    """Number of the curve that is judged: success_rate, episode_return, or a metric of the task."""
    minimize: bool = False
    """Whether less is better."""
    last: int = 5
    """Iterations at the end whose mean is the value."""
    seed: int = 0
    """Seed of the search."""
    interval: int = 0
    """Iterations between exchanges of a population."""
    cpus: float = 1.0
    """Cores that a training takes of the cluster."""
    gpus: float = 0.0
    """GPUs that a training takes of the cluster; 0.5 lets two share one."""


@dataclass(frozen=True, kw_only=True)
class SweepPlan:
    """Sweep that has been read and checked."""

    options: SweepOptions
    """Keys of the file outside of its tables."""
    train: TrainSettings
    """Settings of every training."""
    vary: Mapping[str, Choices] = field(default_factory=dict)
    """Choices by path, such as ``ppo.clip``."""

    def settings(self, values: Values, seed: int) -> TrainSettings:
        """Return the settings of one training.

        Args:
            values: by path.
            seed: of the training.
        """
        chosen = replace(self.train, seed=seed)
        for path, value in values.items():
            option, _, key = path.partition(".")
            if option in _WORDS:
                words = (*getattr(chosen, option), f"{key}={_word(value)}")
                chosen = replace(chosen, **{option: words})
            elif key:
                chosen = replace(chosen, **{option: {**getattr(chosen, option), key: value}})
            else:
                chosen = replace(chosen, **{option: value})
        return chosen


def read_plan(path: Path) -> SweepPlan:
    """Read a sweep's file.

    Raises:
        ConfigurationError: the file is not readable, or what it asks for contradicts itself.
        UnknownNameError: a key or a setting is unknown; names the nearest.
    """
    where = f"sweep {path}"
    content = read_toml(path, "sweep's file")
    tables = {name: content.pop(name, {}) for name in ("train", "vary")}
    for name, table in tables.items():
        if not isinstance(table, dict):
            raise ConfigurationError(f"{name} of {where} is a table: write [{name}]")
    if unknown := content.keys() - field_types(SweepOptions).keys():
        raise UnknownNameError("key", min(unknown), [*field_types(SweepOptions), *tables], where)
    options = configured(SweepOptions(), content, where, "key")
    train = _training(tables["train"], where)
    vary = {path: _choices(path, given, where) for path, given in _flat(tables["vary"]).items()}
    plan = SweepPlan(options=options, train=train, vary=vary)
    _check(plan, where)
    _check_values(plan, where)
    return plan


def _training(table: Mapping[str, Any], where: str) -> TrainSettings:
    owned = ("seed", "output", "resume", *COMMAND_LINE_ONLY)
    for key in table:
        if key in owned:
            raise ConfigurationError(f"[train] of {where} sets {key}, which each training of the sweep has itself")
        if key not in field_types(TrainSettings):
            raise UnknownNameError("key", key, field_types(TrainSettings).keys() - {*owned}, f"[train] of {where}")
    values = {key: _words(value) if key in _WORDS else value for key, value in table.items()}
    train = configured(TrainSettings(), values, f"[train] of {where}", "key")
    if train.task is None or train.iterations is None:
        raise ConfigurationError(f"[train] of {where} names the task and the number of iterations")
    return train


def _words(value: Any) -> Any:
    """Return a table of settings as words ``key=value``; what is a list already stays."""
    return [f"{key}={_word(each)}" for key, each in value.items()] if isinstance(value, dict) else value


def _word(value: Any) -> str:
    return ",".join(map(str, value)) if isinstance(value, list | tuple) else str(value)


def _flat(table: Mapping[str, Any], before: str = "") -> dict[str, Any]:
    """Return choices by path; TOML makes tables of dots in keys that are not quoted."""
    flat: dict[str, Any] = {}
    for key, value in table.items():
        # A table with low is a range, thus a choice; any other holds settings one level down.
        if isinstance(value, dict) and "low" not in value:
            flat |= _flat(value, f"{before}{key}.")
        else:
            flat[f"{before}{key}"] = value
    return flat


def _choices(path: str, given: Any, where: str) -> Choices:
    option, _, key = path.partition(".")
    known = field_types(TrainSettings).keys() - {"seed", "output", "resume", "iterations", *COMMAND_LINE_ONLY}
    if option not in known:
        raise UnknownNameError("setting", option, known, f"[vary] of {where}")
    if bool(key) != (option in (*_WORDS, *_TABLES)):
        raise ConfigurationError(
            f"[vary] of {where} names {path}: settings of {', '.join((*_WORDS, *_TABLES))} are written with a dot "
            "('ppo.clip'), others without one"
        )
    if isinstance(given, dict):
        return from_plain(Range, given, f"[vary] {path} of {where}")
    if not isinstance(given, list) or not given:
        raise ConfigurationError(
            f"[vary] {path} of {where} is a list of values, or a range {{ low = 0.1, high = 0.3 }}, not {given!r}"
        )
    return tuple(given)


def _check_values(plan: SweepPlan, where: str) -> None:
    """Refuse what a training would refuse, before the first one: each value, next to the first ones of the others."""
    tried = {path: _tried(choices) for path, choices in plan.vary.items()}
    for path, values in tried.items():
        for value in values if "." not in path else ():
            configured(plan.train, {path: value}, f"[vary] of {where}", "setting")
    firsts = {path: values[0] for path, values in tried.items()}
    check_training(plan.train)
    for path, values in tried.items():
        for value in values:
            try:
                check_training(plan.settings({**firsts, path: value}, 0))
            except OrbitError as error:
                raise ConfigurationError(f"[vary] {path} of {where} is {value!r}: {error}") from None


def _tried(choices: Choices) -> tuple[Any, ...]:
    """Return all values of a list; of a range both ends, and a number between them, which shows if it must be whole."""
    if not isinstance(choices, Range):
        return choices
    return choices.rounded(choices.low), choices.drawn(random.Random(0)), choices.rounded(choices.high)


def _check(plan: SweepPlan, where: str) -> None:
    options, ranges = plan.options, [path for path, each in plan.vary.items() if isinstance(each, Range)]
    if options.search not in SEARCHES:
        raise UnknownNameError("search", options.search, SEARCHES, where)
    if not options.seeds or len({*options.seeds}) < len(options.seeds):
        raise ConfigurationError(f"seeds of {where} are different numbers, one at least")
    if not plan.vary and len(options.seeds) == 1:
        raise ConfigurationError(f"{where} varies nothing: give [vary] a setting, or seeds more than one")
    if options.search == "grid":
        if ranges:
            raise ConfigurationError(f"a grid has lists, but {ranges[0]} of {where} is a range: search random or tpe")
        if options.trials:
            raise ConfigurationError(f"{where} is a grid, which tries all combinations: leave trials out")
    elif options.trials < 1:
        raise ConfigurationError(f"{where} searches {options.search}: give the number of trials")
    for name in ("last", "cpus"):
        if getattr(options, name) <= 0:
            raise ConfigurationError(f"{name} of {where} is above zero, not {getattr(options, name)}")
    if options.gpus < 0.0:
        raise ConfigurationError(f"gpus of {where} is not negative, not {options.gpus:g}")
    if options.search == "population":
        if not 0 < options.interval < (plan.train.iterations or 0) or options.trials < 2:
            raise ConfigurationError(
                f"a population of {where} has two trials or more, and exchanges them each interval of iterations, "
                "which is less than all"
            )
        for path in plan.vary:
            if "." not in path or path.rpartition(".")[2] in _IN_CHECKPOINT:
                raise ConfigurationError(
                    f"a population of {where} cannot vary {path}, which a training keeps from its first iteration: "
                    "search random or tpe"
                )
    elif options.interval:
        raise ConfigurationError(f"interval of {where} is a population's: search population, or leave it out")
