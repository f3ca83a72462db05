"""Registration of every task with Gymnasium, as ``orbit/<Task>-v0``."""

from __future__ import annotations

import importlib.abc
import importlib.machinery
import importlib.util
import sys
from collections.abc import Sequence
from types import ModuleType

from orbit_core.envs.registry import task_entries


class GymnasiumFinder(importlib.abc.MetaPathFinder):
    """Registers all tasks as soon as Gymnasium is imported, which takes half a second that listing names can spare."""

    def __init__(self) -> None:
        self._asking = False

    def find_spec(
        self, fullname: str, path: Sequence[str] | None, target: ModuleType | None = None
    ) -> importlib.machinery.ModuleSpec | None:
        """Return Gymnasium's own specification, with a loader that registers the tasks at the end."""
        if fullname != "gymnasium" or self._asking:
            return None
        self._asking = True
        try:
            spec = importlib.util.find_spec(fullname)
        finally:
            self._asking = False
        if spec is not None and spec.loader is not None:
            execute = spec.loader.exec_module

            def exec_module(module: ModuleType) -> None:
                execute(module)
                register()

            spec.loader.exec_module = exec_module
        return spec


def register_when_imported() -> None:
    """Register all tasks with Gymnasium now if it is imported, else when it is."""
    if "gymnasium" in sys.modules:
        register()
    elif not any(isinstance(finder, GymnasiumFinder) for finder in sys.meta_path):
        sys.meta_path.insert(0, GymnasiumFinder())


def register() -> None:
    """Register all tasks with Gymnasium, each once."""
    import gymnasium

    for name in task_entries():
        identity = f"orbit/{name}-v0"
        # Gymnasium warns of a second registration, and imports may come in any order.
        if identity in gymnasium.registry:
            continue
        # No max_episode_steps: the environment holds the time limit itself.
        gymnasium.register(
            id=identity,
            entry_point="orbit_learn.gymnasium:SingleEnvironment",
            vector_entry_point="orbit_learn.gymnasium:VectorEnvironment",
            kwargs={"task": name},
        )
