"""Setting a task's fields by name, from the command line, a file or a keyword."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import is_dataclass
from functools import partial
from typing import Any, TypeVar

from orbit_core.actions import ActionTerms
from orbit_core.configuration import Presets, configured, field_types
from orbit_core.envs.action_terms import action_terms
from orbit_core.envs.task import COMPOSED, MOVED_FIELDS, Task
from orbit_core.interfaces import ConfigurationError
from orbit_core.objects import ObjectConfig, object_config, object_kinds

DEFAULT_PRESET = "state"
"""Stands for what a task observes by default."""
ACTIONS = "actions"

_TaskType = TypeVar("_TaskType", bound=Task)


def configure(task_type: type[_TaskType], values: Mapping[str, Any]) -> _TaskType:
    """A task with some of its fields set, by path: :func:`orbit_core.configuration.configured`.

    A word for ``observations`` takes the task's preset of that name; a word for a field annotated
    :class:`~orbit_core.objects.ObjectConfig` takes the kind of object of that name. A path
    below ``actions`` changes the task's own action terms, or those that its action space stands for.

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
        # The word for an action space is spelt out for this robot, so that there are terms to change.
        task.actions, task.action = ActionTerms(**action_terms(task, task.scene())), COMPOSED
    return configured(task, below, owner)


def _check_renamed(task_type: type[Task], values: Mapping[str, Any]) -> None:
    """Refuse paths of fields by the names that they had.

    Raises:
        ConfigurationError: a field has another name now; names it.
    """
    renamed = {**MOVED_FIELDS, **task_type.renamed}
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
