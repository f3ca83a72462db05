"""Setting a task's fields by name, from the command line, a file or a keyword."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, TypeVar

from orbit_core.configuration import configured
from orbit_core.envs.task import Task
from orbit_core.interfaces import ConfigurationError

DEFAULT_PRESET = "state"
"""Stands for what a task observes by default."""
_TaskType = TypeVar("_TaskType", bound=Task)


def configure(task_type: type[_TaskType], values: Mapping[str, Any]) -> _TaskType:
    """A task with some of its fields set, by path: :func:`orbit_core.configuration.configured`.

    A word for ``observations`` takes the task's preset of that name.

    Raises:
        UnknownNameError: the task has no such field or preset; names the nearest.
        ConfigurationError: a value is not of the kind that the field takes, or not finite.
    """
    owner = f"task {task_type.__name__}"
    try:
        defaults = task_type()  # pyright: ignore[reportCallIssue] - subclasses give every field a default
    except TypeError as error:
        raise ConfigurationError(f"{owner} cannot be made by name, for a field has no default: {error}") from error
    observations = {DEFAULT_PRESET: lambda: defaults.observations, **task_type.observation_presets}
    return configured(defaults, values, owner, presets={"observations": observations})
