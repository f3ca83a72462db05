"""Registries of tasks and of sources of starts: groups ``orbit.tasks``, ``orbit.task_files`` and ``orbit.starts``."""

from __future__ import annotations

import importlib
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cache, lru_cache
from typing import TYPE_CHECKING, Any, Protocol

from orbit_core.registry import Registry, faults_named

if TYPE_CHECKING:
    from torch import Tensor

    from orbit_core.envs.captured_step import CapturableEnvironment
    from orbit_core.envs.task import Task


@dataclass(frozen=True)
class TaskEntry:
    """A task by name.

    ``factory`` is ``"module:Class"``, imported when the task is made, or a function that returns the class.
    """

    name: str
    """Name for commands, such as ``Lift``."""
    description: str
    """One line for ``orbit list tasks``."""
    factory: str | Callable[[], type[Task]]

    def task_type(self) -> type[Task]:
        """The task's class.

        Raises:
            ConfigurationError: its module cannot be imported, or has no such class.
        """
        if callable(self.factory):
            return self.factory()
        module, _, attribute = self.factory.partition(":")
        with faults_named(f"task '{self.name}' ({self.factory})"):
            return getattr(importlib.import_module(module), attribute)


class TaskRegistry:
    """Collects entries; each entry point is a function that takes one of these and adds to it."""

    def __init__(self) -> None:
        self.registry = Registry[TaskEntry]("task", "orbit.tasks", lambda register: register(self))
        """Entries of all installed distributions, loaded on first use."""

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
    """The task of that name, or the one that a file describes.

    A package reads files that end in ``.NAME`` by an entry point of that name in the group ``orbit.task_files``, a
    function that takes the path and returns the task's class.

    Raises:
        UnknownNameError: there is none.
        ConfigurationError: two packages bring it.
    """
    _, dot, suffix = name.rpartition(".")
    if dot and suffix in _task_files().names:
        read = _task_files().get(suffix)
        return TaskEntry(name, f"task of the file {name}", lambda: read(name))
    return _installed().get(name)


@cache
def _task_files() -> Registry[Callable[[str], type[Task]]]:
    return Registry("form of task files", "orbit.task_files")


class EpisodeStarts(Protocol):
    """Source of states at which a share of episodes begins, :class:`orbit_motion.experts.starts.ExpertStarts`."""

    seen: Tensor
    """(M, O) observations of the policy on the way to those states."""
    done: Tensor
    """(M, A) actions that were taken there."""
    began_there: Tensor
    """(N,) bool: which of the present episodes began at such a state."""

    def record(self, environment: CapturableEnvironment, action: Tensor) -> None:
        """Find the states, once, before the first episode.

        Args:
            environment: to play in.
            action: (N, A) that the environment's next step does.
        """
        ...

    def begin(self, env_ids: Tensor | None) -> None:
        """Put some of these environments, by index, by mask, or all, at such states; called after a reset's events."""
        ...

    def metrics(self) -> Mapping[str, Tensor]:
        """Return metrics (N,) of the episodes, by name."""
        ...


@cache
def episode_starts() -> Registry[Callable[[Any], EpisodeStarts]]:
    """Return constructors of starts, which take the environment, from the entry-point group ``orbit.starts``."""
    return Registry("source of starts", "orbit.starts")
