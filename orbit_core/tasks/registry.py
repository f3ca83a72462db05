"""Which tasks there are. Plugins add theirs through the entry-point group ``orbit.tasks``."""

from __future__ import annotations

import importlib
from dataclasses import dataclass
from functools import lru_cache
from typing import TYPE_CHECKING

from importlib_metadata import entry_points

from orbit_core.interfaces import ConfigurationError, UnknownNameError

if TYPE_CHECKING:
    from orbit_core.tasks.task import Task


@dataclass(frozen=True)
class TaskEntry:
    """A task by name. ``factory`` is ``"module:Class"``, imported when the task is made."""

    name: str
    description: str
    factory: str

    def task_type(self) -> type[Task]:
        """The task's class."""
        module, _, attribute = self.factory.partition(":")
        return getattr(importlib.import_module(module), attribute)


class TaskRegistry:
    """Collects entries; each entry point is a function that takes one of these and adds to it."""

    def __init__(self) -> None:
        self.entries: dict[str, TaskEntry] = {}

    def add(self, name: str, description: str, factory: str) -> None:
        """Add a task.

        Raises:
            ConfigurationError: the name is taken.
        """
        if name in self.entries:
            taken = self.entries[name].factory
            raise ConfigurationError(f"task '{name}' is registered twice: by {taken} and by {factory}; rename one")
        self.entries[name] = TaskEntry(name, description, factory)


@lru_cache(maxsize=1)
def task_entries() -> dict[str, TaskEntry]:
    """All registered tasks by name."""
    registry = TaskRegistry()
    for point in entry_points(group="orbit.tasks"):
        point.load()(registry)
    return registry.entries


def task_entry(name: str) -> TaskEntry:
    """The task of that name.

    Raises:
        UnknownNameError: there is none.
    """
    entries = task_entries()
    if name not in entries:
        raise UnknownNameError("task", name, entries)
    return entries[name]
