"""Configuration of tasks: fields set by name, checks, and changes while an environment runs."""

from __future__ import annotations

import math
import operator
from collections.abc import Mapping
from dataclasses import FrozenInstanceError, fields, is_dataclass, replace
from functools import partial
from typing import Any, TypeVar

from orbit_core.actions import ActionTerms
from orbit_core.capture.python_state import Values
from orbit_core.configuration import Presets, configured, field_types
from orbit_core.dynamics.arguments import MOST_STEPS, whole_number
from orbit_core.envs.action_manager import action_terms
from orbit_core.envs.observation_layout import groups_of
from orbit_core.envs.task import COMPOSED, MOVED_FIELDS, Task
from orbit_core.envs.terms import CurriculumTerm, ModifyTerm, Term, terms_of
from orbit_core.interfaces import ConfigurationError, UnknownNameError
from orbit_core.objects import ObjectConfig, object_config, object_kinds

# Word for the default observations of a task.
DEFAULT_PRESET = "state"
ACTIONS = "actions"

_TaskType = TypeVar("_TaskType", bound=Task)


def configure(task_type: type[_TaskType], values: Mapping[str, Any]) -> _TaskType:
    """A task with some of its fields set, by path: :func:`orbit_core.configuration.configured`.

    A word for ``observations`` takes the task's preset of that name; a word for a field annotated
    :class:`~orbit_core.objects.ObjectConfig` takes the kind of object of that name. A path
    below ``actions`` changes the task's own action terms, or those of its action space.

    Raises:
        UnknownNameError: the task has no such field or preset; names the nearest.
        ConfigurationError: a value is not of the kind that the field takes, or not finite.
    """
    owner = f"task {task_type.__name__}"
    _check_renamed(task_type, values)
    try:
        defaults = task_type()  # pyright: ignore[reportCallIssue] - subclasses give every field a default
    except TypeError as error:
        raise ConfigurationError(f"{owner} cannot be made by name, for a field has no default: {error}") from error
    below = {path: value for path, value in values.items() if path.partition(".")[0] == ACTIONS}
    others = {path: value for path, value in values.items() if path not in below}
    task = configured(defaults, others, owner, presets=_presets(defaults))
    if below and task.actions is None and not is_dataclass(below.get(ACTIONS)):
        # The preset is expanded for this robot, so that there are terms to change.
        task.actions, task.action = ActionTerms(**action_terms(task, task.scene())), COMPOSED
    return configured(task, below, owner)


def _check_renamed(task_type: type[Task], values: Mapping[str, Any]) -> None:
    """Refuse paths of fields by the names that they had.

    Raises:
        ConfigurationError: a field has another name now; names it.
    """
    renamed = {**MOVED_FIELDS, **task_type.renamed}
    # A table may be renamed as a whole, so every prefix of a path is looked up.
    for path in values:
        parts = path.split(".")
        for count in range(1, len(parts) + 1):
            old = ".".join(parts[:count])
            if old in renamed:
                now = ".".join((renamed[old], *parts[count:]))
                raise ConfigurationError(f"field '{path}' of task {task_type.__name__} is now '{now}'")


def _presets(task: Task) -> Presets:
    """The words that fields of a task take in the place of a value."""
    presets = {"observations": {DEFAULT_PRESET: lambda: task.observations, **task.observation_presets}}
    for name, hint in field_types(type(task)).items():
        if hint is ObjectConfig:
            presets[name] = {kind: partial(object_config, kind) for kind in object_kinds().names}
    return presets


# Steps of an episode; step counters have 64 bits, and libraries keep them in 32.
_LONGEST_EPISODE = 2**31 - 1


def check_no_backend(given: Mapping[str, object]) -> None:
    """Refuse settings of a backend, by name, where a world is given.

    Raises:
        ConfigurationError: one of them is not None.
    """
    named = [name for name, value in given.items() if value is not None]
    if named:
        raise ConfigurationError(
            f"{' and '.join(named)} given beside a world of your own: only what is simulated has any; leave one out"
        )


def curriculum_of(task: Task) -> dict[str, CurriculumTerm]:
    """Terms of the task's curriculum; empty where it is not enabled.

    Raises:
        ConfigurationError: it is enabled, and the task has none.
    """
    if not task.curriculum_enabled:
        return {}
    if task.curriculum is None:
        raise ConfigurationError(
            f"task {type(task).__name__} has no curriculum: leave curriculum_enabled out, or give it a dataclass of "
            "CurriculumTerm or ModifyTerm"
        )
    return {n: term for n, term in _curriculum_terms(task).items() if isinstance(term, CurriculumTerm)}


def modifiers_of(task: Task) -> dict[str, ModifyTerm]:
    """Terms of the task's curriculum that change its configuration; empty where it is not enabled."""
    if not task.curriculum_enabled:
        return {}
    return {n: term for n, term in _curriculum_terms(task).items() if isinstance(term, ModifyTerm)}


def _curriculum_terms(task: Task) -> dict[str, CurriculumTerm | ModifyTerm]:
    kinds: Any = CurriculumTerm | ModifyTerm
    return terms_of(task.curriculum, kinds)


def whole_steps(task: Task) -> int:
    """Steps of the environment in an episode.

    Raises:
        ConfigurationError: there is no whole number of them.
    """
    for name in ("physics_dt", "episode_length"):
        seconds = getattr(task, name)
        if not 0.0 < seconds < math.inf:
            raise ConfigurationError(f"{name} must be above zero seconds, not {seconds:g}")
    whole_number(task.decimation, "decimation", 1, MOST_STEPS)
    step_dt = task.physics_dt * task.decimation
    if not task.episode_length / step_dt <= _LONGEST_EPISODE:
        raise ConfigurationError(
            f"episode_length {task.episode_length:g} s has more than {_LONGEST_EPISODE:,} steps of {step_dt:g} s: "
            "give a shorter one"
        )
    steps = round(task.episode_length / step_dt)
    if steps < 1 or abs(steps * step_dt - task.episode_length) > 1e-6 * task.episode_length:
        raise ConfigurationError(
            f"episode_length {task.episode_length} s is no whole number of steps of {step_dt} s (physics_dt x "
            f"decimation): use {max(1, steps) * step_dt:g}"
        )
    return steps


_COLLECTIONS = ("commands", "rewards", "terminations", "events", "curriculum", "premises", "observations")
# Fields that are read when an environment is made, and never again.
_FIXED = (
    "robot", "action", "physics_dt", "decimation", "episode_length", "settle_time", "premise_time",
    "domain_randomization", "curriculum_enabled", "expert_starts", "expert_phase",
)  # fmt: skip


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
