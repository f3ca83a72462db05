"""Old import paths: modules that moved into other distributions still import under their old names, with a warning.

The tables (here and in old_names.toml) hold for one release. A module's old name gives the very same module.
"""

from __future__ import annotations

import functools
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

_TABLE = Path(__file__).with_name("old_names.toml")
_ROBOTS = ("RobotCatalogue", "RobotEntry", "robot", "robot_info", "robot_names")
_OBJECTS = ("ObjectConfig", "object_config", "object_kinds")
NAMES = {
    "orbit_motion": {"orbit_core.actions": ()},
    "orbit_assets": {
        "orbit_core.robots": _ROBOTS,
        "orbit_core.objects": _OBJECTS,
        "orbit_core.preparation.merge": ("merge_fixed_links",),
        "orbit_core.preparation.validation": ("sort_links", "validate", "validate_entity"),
    },
    "orbit_assets.object_kinds": {"orbit_core.objects": _OBJECTS},
    "orbit_assets.drive_design": {
        "orbit_core.dynamics.workspace": ("DriveResponse", "ReflectedInertia", "drive_responses", "reflected_inertia"),
    },
    "orbit_core.cli.settings": {
        "orbit_learn.cli.trained": ("PlaySettings",),
        "orbit_motion.cli.grasp": ("GraspSettings",),
        "orbit_viewer.cli.view": ("ViewSettings",),
    },
    "orbit_core.envs": {"orbit_motion.experts": ()},
    "orbit_core.mdp.common": {"orbit_assets.objects": ("BENCH_HEIGHT", "work_bench")},
    "orbit_core.sensors": {"orbit_data.bounding_boxes": ("BoundingBoxes2d", "BoundingBoxes3d")},
}
"""Module -> modules that have names now which were its own: these, or all of ``__all__`` where none is given."""


@functools.cache
def old_modules() -> dict[str, str]:
    """Return the name that each module or package has now by its old one; the longest prefix counts."""
    table = tomllib.loads(_TABLE.read_text(encoding="utf-8"))
    merged = {f"{new.rpartition('.')[0]}.{old}": new for new, olds in table["merged"].items() for old in olds}
    return table["moved"] | merged


def moved_name(module: str, name: str) -> Any:
    """Return what a module had under a name, from the module that has it now.

    Raises:
        AttributeError: it never had that name, or the distribution that brings it is not installed.
    """
    for other, names in NAMES[module].items():
        if names and name not in names:
            continue
        try:
            found = importlib.import_module(other)
        except ModuleNotFoundError:
            continue
        if name in (names or found.__all__):
            _warn(f"{module}.{name}", f"{other}.{name}", 3)
            return getattr(found, name)
    raise AttributeError(f"module '{module}' has no attribute '{name}'")


def new_name(name: str) -> str | None:
    """Return the name that a module has now; None where it has not moved."""
    parts = name.split(".")
    for count in range(len(parts), 1, -1):
        if (new := old_modules().get(".".join(parts[:count]))) is not None:
            return ".".join([new, *parts[count:]])
    return None


class MovedFinder(importlib.abc.MetaPathFinder, importlib.abc.Loader):
    """Finds modules by their old names."""

    def find_spec(
        self, fullname: str, path: Sequence[str] | None, target: ModuleType | None = None
    ) -> importlib.machinery.ModuleSpec | None:
        """Return a specification that loads the module of the new name, if the name is an old one."""
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


def install() -> None:
    """Let old names be imported; once."""
    if not any(isinstance(finder, MovedFinder) for finder in sys.meta_path):
        sys.meta_path.insert(0, MovedFinder())  # before what finds files in the folder of a package under its old name


def _warn(old: str, new: str, level: int) -> None:
    warnings.warn(f"{old} is {new} now; the old name goes with the next release", FutureWarning, stacklevel=level + 1)
