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

from orbit_core.interfaces.errors import UnknownNameError
from orbit_core.registry import Registry, faults_named

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
        """Build the robot.

        Raises:
            AssetError: its model cannot be had.
            ConfigurationError: the module that builds it cannot be imported.
        """
        if callable(self.build):
            return self.build()
        module, _, function = self.build.partition(":")
        with faults_named(f"robot '{self.name}' ({self.build})"):
            build = getattr(importlib.import_module(module), function)
        return build()

    @cached_property
    def dof(self) -> int:
        """The number of joints that move freely, mimics left out. Builds the robot."""
        return sum(joint.mimic is None for joint in self.load().articulation.movable_joints)


class RobotCatalogue:
    """Robots by name; each entry point is a function that takes one of these and adds to it."""

    def __init__(self) -> None:
        self._registry = Registry[RobotEntry]("robot", ENTRY_POINT_GROUP, lambda register: register(self))

    @property
    def entries(self) -> dict[str, RobotEntry]:
        """All robots by name, those of broken packages left out."""
        return self._registry.values

    def add(self, entry: RobotEntry) -> None:
        """Add a robot.

        Raises:
            ConfigurationError: the name is taken.
        """
        self._registry.add(entry.name, entry)

    def entry(self, name: str) -> RobotEntry:
        """The robot's entry.

        Raises:
            UnknownNameError: there is none of that name.
            ConfigurationError: two packages bring it.
        """
        return self._registry.get(name)


@cache
def robots() -> RobotCatalogue:
    """The catalogue of all installed robots, read once."""
    return RobotCatalogue()


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
