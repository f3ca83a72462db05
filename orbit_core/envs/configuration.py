"""Setting a task's fields by name, from the command line, a file or a keyword."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import fields
from typing import Any, TypeVar

from orbit_core.envs.task import Task
from orbit_core.interfaces import UnknownNameError
from orbit_core.interfaces.fields import check_kind

_TaskType = TypeVar("_TaskType", bound=Task)


def configure(task_type: type[_TaskType], values: Mapping[str, Any]) -> _TaskType:
    """A task with some of its fields set.

    Raises:
        UnknownNameError: the task has no such field; names the nearest.
        ConfigurationError: a value is not of the kind of the field's default, or not finite.
    """
    settable = {field.name: field for field in fields(task_type) if field.init}
    for name, value in values.items():
        if name not in settable:
            raise UnknownNameError("field", name, settable, f"task {task_type.__name__}")
        check_kind(f"field '{name}' of task {task_type.__name__}", value, settable[name].default)
    return task_type(**values)
