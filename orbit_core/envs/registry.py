"""Registry of tasks. Plugins add theirs through the entry-point group ``orbit.tasks``."""

from __future__ import annotations

import importlib
from dataclasses import dataclass
from functools import lru_cache
from typing import TYPE_CHECKING

from orbit_core.registry import Registry, faults_named

if TYPE_CHECKING:
    from orbit_core.envs.task import Task


@dataclass(frozen=True)
class TaskEntry:
    """A task by name. ``factory`` is ``"module:Class"``, imported when the task is made."""

    name: str
    description: str
    factory: str

    def task_type(self) -> type[Task]:
        """The task's class.

        Raises:
            ConfigurationError: its module cannot be imported, or has no such class.
        """
        module, _, attribute = self.factory.partition(":")
        with faults_named(f"task '{self.name}' ({self.factory})"):
            return getattr(importlib.import_module(module), attribute)


class TaskRegistry:
    """Collects entries; each entry point is a function that takes one of these and adds to it."""

    def __init__(self) -> None:
        self.registry = Registry[TaskEntry]("task", "orbit.tasks", lambda register: register(self))

    def add(self, name: str, description: str, factory: str) -> None:
        """Add a task.

        Raises:
            ConfigurationError: the name is taken.
        """
        self.registry.add(name, TaskEntry(name, description, factory))


@lru_cache(maxsize=1)
def _installed() -> Registry[TaskEntry]:
    return TaskRegistry().registry


def task_entries() -> dict[str, TaskEntry]:
    """All registered tasks by name, those of broken packages left out."""
    return _installed().values


def task_entry(name: str) -> TaskEntry:
    """The task of that name.

    Raises:
        UnknownNameError: there is none.
        ConfigurationError: two packages bring it.
    """
    return _installed().get(name)
