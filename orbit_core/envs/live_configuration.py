"""The task's configuration while it runs: changes are noticed before each step, and a curriculum may make them."""

from __future__ import annotations

import operator
from collections.abc import Mapping
from dataclasses import FrozenInstanceError, fields, is_dataclass, replace
from typing import Any

from orbit_core.capture.python_state import Values
from orbit_core.envs.observation_groups import groups_of
from orbit_core.envs.task import Task
from orbit_core.envs.terms import ModifyTerm, Term
from orbit_core.interfaces import ConfigurationError, UnknownNameError

_COLLECTIONS = ("commands", "rewards", "terminations", "events", "curriculum", "premises", "observations")
_FIXED = (
    "robot", "action", "physics_dt", "decimation", "episode_length", "settle_time", "premise_time",
    "domain_randomization", "curriculum_enabled", "expert_starts",
)  # fmt: skip
"""Fields that are read when an environment is made, and never again."""


_WATCHED = _COLLECTIONS + _FIXED


class ConfigurationWatch:
    """Notices that a term, or one of a term's fields, is another than before.

    Args:
        task: whose collections of terms are watched.

    Raises:
        ConfigurationError: a field that only counts when the environment is made was set; :meth:`changed` raises it.
    """

    def __init__(self, task: Task) -> None:
        self._task = task
        self._fields = vars(task).__getitem__
        self._look()

    def changed(self) -> bool:
        """Return True if something changed since the last call; a few microseconds where nothing did."""
        if all(map(operator.is_, map(self._fields, _WATCHED), self._known)) and self._values.unchanged():
            return False
        before = dict(zip(_WATCHED, self._known, strict=True))
        for name in _FIXED:
            if (now := self._fields(name)) != before[name]:
                raise ConfigurationError(
                    f"field '{name}' of task {type(self._task).__name__} was set to {now!r}, but is read only when an "
                    "environment is made: make another one"
                )
        self._look()
        return True

    def _look(self) -> None:
        self._known = [self._fields(name) for name in _WATCHED]
        collections = [self._fields(name) for name in _COLLECTIONS]
        holders = [value for value in (*collections, *groups_of(self._task).values()) if value is not None]
        terms = [term for holder in holders for term in vars(holder).values() if isinstance(term, Term)]
        self._values = Values(vars(each) for each in (*holders, *terms))


class Modifiers:
    """Runs the curriculum terms that change the task's configuration.

    Args:
        task: that they change.
        terms: by name.

    Raises:
        UnknownNameError: an address leads nowhere; names the nearest.
        ConfigurationError: an address is that of a collection, or of what the environment was made of.
    """

    def __init__(self, task: Task, terms: Mapping[str, ModifyTerm]) -> None:
        self._task = task
        self.terms = terms
        for name, term in terms.items():
            value = _value_at(task, term.address, name)
            set_value(task, term.address, value, name)

    def run(self, steps: int) -> None:
        """Set each term's value for the next step, where it is another."""
        for name, term in self.terms.items():
            before = _value_at(self._task, term.address, name)
            value = term.function(steps, before)
            if value is not before and value != before:
                set_value(self._task, term.address, value, name)


def set_value(task: Task, address: str, value: Any, what: str) -> None:
    """Set the value at a path in a task; what is frozen on the way is replaced.

    Raises:
        ConfigurationError: nothing on the way can be set.
    """
    above, _, name = address.rpartition(".")
    owner = _value_at(task, above, what) if above else task
    try:
        setattr(owner, name, value)
    except FrozenInstanceError:
        set_value(task, above, replace(owner, **{name: value}), what)
    except AttributeError as error:
        raise ConfigurationError(f"curriculum term '{what}' cannot set '{address}': {error}") from None


def _value_at(task: Task, address: str, what: str) -> Any:
    value: Any = task
    for name in address.split("."):
        known = [field.name for field in fields(value)] if is_dataclass(value) else list(getattr(value, "__dict__", ()))
        if name not in known or not hasattr(value, name):
            raise UnknownNameError("name", name, known, f"'{address}' of task {type(task).__name__}, which curriculum "
                                   f"term '{what}' changes")  # fmt: skip
        value = getattr(value, name)
    return value
