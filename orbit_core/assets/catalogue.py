"""Robots by name. Any installed package may add its own through the entry point group ``orbit.robots``.

An entry point names a function ``register(catalogue)`` that calls :meth:`RobotCatalogue.add`. Listing names builds
nothing and imports nothing heavy.
"""

from __future__ import annotations

import dataclasses
import importlib
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cache, cached_property
from typing import TYPE_CHECKING, Any

from importlib_metadata import entry_points

from orbit_core.interfaces.errors import ConfigurationError, UnknownNameError

if TYPE_CHECKING:
    from orbit_core.scene import RobotSpec

ENTRY_POINT_GROUP = "orbit.robots"


@dataclass(frozen=True)
class RobotEntry:
    """A robot that can be built by name.

    ``build`` takes nothing and returns the robot; as text, ``"module:function"``, it is imported only when needed.
    """

    name: str
    description: str
    build: Callable[[], RobotSpec] | str
    source: str = ""
    """The package that the model comes from."""
    licence: str = ""

    def load(self) -> RobotSpec:
        """Build the robot."""
        if callable(self.build):
            return self.build()
        module, _, function = self.build.partition(":")
        return getattr(importlib.import_module(module), function)()

    @cached_property
    def dof(self) -> int:
        """The number of joints that move freely, mimics left out. Builds the robot."""
        return sum(joint.mimic is None for joint in self.load().articulation.movable_joints)


class RobotCatalogue:
    """Robots by name, and who added each."""

    def __init__(self) -> None:
        self.entries: dict[str, RobotEntry] = {}
        self._added_by: dict[str, str] = {}
        self._adding = "this program"

    def add(self, entry: RobotEntry) -> None:
        """Add a robot.

        Raises:
            ConfigurationError: the name is taken.
        """
        if entry.name in self.entries:
            raise ConfigurationError(
                f"robot '{entry.name}' is registered twice, by {self._added_by[entry.name]} and by {self._adding}: "
                "rename one, or uninstall one of the two packages"
            )
        self.entries[entry.name] = entry
        self._added_by[entry.name] = self._adding

    def add_installed(self) -> None:
        """Add the robots of every installed package that declares some.

        Raises:
            ConfigurationError: a package fails to load, or two give the same name.
        """
        for point in entry_points(group=ENTRY_POINT_GROUP):
            self._adding = f"entry point '{point.name}' ({point.value})"
            try:
                register = point.load()
            except Exception as error:  # a package's own fault may be of any class
                raise ConfigurationError(
                    f"{self._adding} of group {ENTRY_POINT_GROUP} cannot be loaded ({error}): mend or uninstall it"
                ) from error
            register(self)
        self._adding = "this program"

    def entry(self, name: str) -> RobotEntry:
        """The robot's entry.

        Raises:
            UnknownNameError: there is none of that name.
        """
        if name not in self.entries:
            raise UnknownNameError("robot", name, self.entries)
        return self.entries[name]


@cache
def robots() -> RobotCatalogue:
    """The catalogue of all installed robots, read once."""
    catalogue = RobotCatalogue()
    catalogue.add_installed()
    return catalogue


def robot_names() -> list[str]:
    """Names of all installed robots, sorted."""
    return sorted(robots().entries)


def robot_info(name: str) -> RobotEntry:
    """Description, source, licence and degrees of freedom of a robot.

    Raises:
        UnknownNameError: there is none of that name.
    """
    return robots().entry(name)


def robot(name: str, /, **overrides: Any) -> RobotSpec:
    """The robot of that name, with fields of :class:`~orbit_core.scene.RobotSpec` replaced by ``overrides``.

    Raises:
        UnknownNameError: there is no such robot or field.
        AssetError: the package that the model comes from is neither installed nor cached.
    """
    spec = robot_info(name).load()
    fields = [field.name for field in dataclasses.fields(spec)]
    for field in overrides:
        if field not in fields:
            raise UnknownNameError("robot field", field, fields, f"robot('{name}', ...)")
    return replace(spec, **overrides)
