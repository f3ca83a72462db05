"""Setting a task's fields by name, from the command line, a file or a keyword."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import fields
from typing import Any, TypeVar

from orbit_core.envs.task import Task
from orbit_core.interfaces import UnknownNameError
from orbit_core.interfaces.fields import check_kind

DEFAULT_PRESET = "state"
"""Stands for what a task observes by default."""

OBSERVATIONS = "observations"
_TaskType = TypeVar("_TaskType", bound=Task)


def configure(task_type: type[_TaskType], values: Mapping[str, Any]) -> _TaskType:
    """A task with some of its fields set.

    Raises:
        UnknownNameError: the task has no such field; names the nearest.
        ConfigurationError: a value is not of the kind of the field's default, or not finite.

    A word for ``observations`` takes the task's preset of that name.
    """
    settable = {field.name: field for field in fields(task_type) if field.init}
    for name, value in values.items():
        if name not in settable:
            raise UnknownNameError("field", name, settable, f"task {task_type.__name__}")
        check_kind(f"field '{name}' of task {task_type.__name__}", value, settable[name].default)
    if isinstance(word := values.get(OBSERVATIONS), str):
        return task_type(**{**values, OBSERVATIONS: _preset(task_type, word)})
    return task_type(**values)


def _preset(task_type: type[Task], word: str) -> Any:
    """The observations that a word stands for."""
    default = next(field.default_factory for field in fields(task_type) if field.name == OBSERVATIONS)
    presets = {DEFAULT_PRESET: default, **task_type.observation_presets}
    if word not in presets:
        raise UnknownNameError("preset of observations", word, presets, f"task {task_type.__name__}")
    return presets[word]()
