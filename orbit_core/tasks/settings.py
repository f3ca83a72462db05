"""Setting a task's fields by name, from the command line, a file or a keyword."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import fields
from typing import Any, TypeVar

from orbit_core.interfaces import ConfigurationError, UnknownNameError
from orbit_core.tasks.task import Task

_TaskType = TypeVar("_TaskType", bound=Task)


def configure(task_type: type[_TaskType], values: Mapping[str, Any]) -> _TaskType:
    """A task with some of its fields set.

    Raises:
        UnknownNameError: the task has no such field; names the nearest.
        ConfigurationError: a value is not of the kind of the field's default.
    """
    settable = {field.name: field for field in fields(task_type) if field.init}
    for name, value in values.items():
        if name not in settable:
            raise UnknownNameError("field", name, settable, f"task {task_type.__name__}")
        _check_kind(task_type, name, value, settable[name].default)
    return task_type(**values)


def _check_kind(task_type: type[Task], name: str, value: Any, default: Any) -> None:
    if not isinstance(default, bool | int | float | str):
        return
    # A whole number will do for a real one, but true and false are no numbers.
    numeric = isinstance(default, float) and isinstance(value, int | float) and not isinstance(value, bool)
    if not numeric and type(value) is not type(default):
        raise ConfigurationError(
            f"field '{name}' of task {task_type.__name__} is {value!r}, but must be a {type(default).__name__}, "
            f"as its default {default!r}"
        )
