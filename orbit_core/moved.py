"""Old import paths: modules and names that moved still import from where they were, with a warning, for one release.

``old_names.toml`` lists them. A module's old name gives the very same module.
"""

from __future__ import annotations

import importlib
import importlib.abc
import importlib.machinery
import importlib.util
import sys
import tomllib
import warnings
from collections.abc import Sequence
from pathlib import Path
from types import ModuleType
from typing import Any

from orbit_core.installing import install_command
from orbit_core.interfaces.errors import ConfigurationError

_TABLE = tomllib.loads(Path(__file__).with_name("old_names.toml").read_text(encoding="utf-8"))
MODULES: dict[str, str] = _TABLE["modules"]
"""Old name of a module or package -> its name now; the longest prefix counts."""
NAMES: dict[str, dict[str, str]] = _TABLE["names"]
"""Module -> names that it had, each with the module that has it now; ``*`` for all that the other exports."""


def moved_name(module: str, name: str) -> Any:
    """Return what a module had under a name, from the module that has it now.

    Raises:
        AttributeError: it never had that name, or the distribution that brings it is not installed.
    """
    for old, other in NAMES[module].items():
        if old not in (name, "*"):
            continue
        try:
            found = importlib.import_module(other)
        except ModuleNotFoundError:
            continue
        if old == name or name in found.__all__:
            _warn(f"{module}.{name}", f"{other}.{name}", 3)
            return getattr(found, name)
    raise AttributeError(f"module '{module}' has no attribute '{name}'")


def new_name(name: str) -> str | None:
    """Return the name that a module has now; None where it has not moved."""
    parts = name.split(".")
    for count in range(len(parts), 1, -1):
        if (new := MODULES.get(".".join(parts[:count]))) is not None:
            return ".".join([new, *parts[count:]])
    return None


class MovedFinder(importlib.abc.MetaPathFinder, importlib.abc.Loader):
    """Finds modules by their old names, and gives modules the names that they had."""

    def find_spec(
        self, fullname: str, path: Sequence[str] | None, target: ModuleType | None = None
    ) -> importlib.machinery.ModuleSpec | None:
        """Return a specification that loads the module of the new name, or one that had other names before."""
        if fullname in NAMES:
            return _with_old_names(fullname, path, target)
        new = new_name(fullname) if fullname.startswith("orbit_") else None
        if new is None:
            return None
        return importlib.util.spec_from_loader(fullname, MovedFinder(), origin=new)

    def create_module(self, spec: importlib.machinery.ModuleSpec) -> ModuleType:
        """Return the module of the new name.

        Raises:
            ConfigurationError: the distribution that brings it is not installed.
        """
        new = str(spec.origin)
        _warn(spec.name, new, 2)
        try:
            module = importlib.import_module(new)
        except ModuleNotFoundError as error:
            top = new.partition(".")[0]
            if error.name != top:
                raise
            distribution = top.replace("_", "-")
            raise ConfigurationError(
                f"{spec.name} is {new} now, of the distribution {distribution}: {install_command(distribution)}"
            ) from error
        self._spec = module.__spec__
        return module

    def exec_module(self, module: ModuleType) -> None:
        """Give the module its own specification back, which the import system has replaced."""
        module.__spec__ = self._spec


def _with_old_names(
    fullname: str, path: Sequence[str] | None, target: ModuleType | None
) -> importlib.machinery.ModuleSpec | None:
    """Return a module's own specification, with a loader that lets the module answer to names that it had."""
    spec = importlib.machinery.PathFinder.find_spec(fullname, path, target)
    if spec is None or spec.loader is None:
        return spec
    execute = spec.loader.exec_module

    def exec_module(module: ModuleType) -> None:
        execute(module)
        own = vars(module).get("__getattr__")

        def find(name: str) -> Any:
            if own is not None:
                try:
                    return own(name)
                except AttributeError:
                    pass
            return moved_name(fullname, name)

        vars(module)["__getattr__"] = find

    spec.loader.exec_module = exec_module
    return spec


def install() -> None:
    """Let old names be imported; once."""
    if not any(isinstance(finder, MovedFinder) for finder in sys.meta_path):
        sys.meta_path.insert(0, MovedFinder())  # before what finds files in the folder of a package under its old name


def _warn(old: str, new: str, level: int) -> None:
    warnings.warn(f"{old} is {new} now; the old name goes with the next release", FutureWarning, stacklevel=level + 1)
