"""Robots by name. Any installed package may add its own through the entry point group ``orbit.robots``.

An entry point names a function ``register(catalogue)`` that calls :meth:`RobotCatalogue.add`. Listing names builds
nothing and imports nothing heavy.
"""

from __future__ import annotations

import dataclasses
import importlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cache, cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol

from orbit_assets.fitted import read_fitted
from orbit_core.interfaces.errors import ConfigurationError, UnknownNameError
from orbit_core.registry import Registry, faults_named

if TYPE_CHECKING:
    from orbit_core.scene import RobotSpec

ENTRY_POINT_GROUP = "orbit.robots"


class Part(Protocol):
    """A base, an arm or an end effector that robots may be composed of."""

    @property
    def end_effector(self) -> str:
        """An arm's own end effector, by name; empty where it has none."""
        ...

    def composed(self, name: str, others: Sequence[Any]) -> RobotSpec:
        """Return the robot of this part, the first, and of others mounted on it in order."""
        ...


@dataclass(frozen=True)
class RobotEntry:
    """A robot that can be built by name, or a part of one.

    ``build`` takes nothing and returns the robot; as text, ``"module:function"``, it is imported only when needed.
    Where it is empty, the robot is ``part`` with its own end effector.
    """

    name: str
    """Name for :func:`robot` and ``orbit list robots``."""
    description: str
    """One line for lists."""
    build: Callable[[], RobotSpec] | str = ""
    source: str = ""
    """The package that the model comes from."""
    licence: str = ""
    """Licence of the model, as its source states it."""
    part: str = ""
    """``"module:NAME"`` of a :class:`Part`; empty where this is no part."""

    def load(self) -> RobotSpec:
        """Build the robot.

        Raises:
            AssetError: its model is not available.
            ConfigurationError: the module that builds it cannot be imported.
        """
        # A function where a package builds the robot itself; text where importing it would be slow.
        if callable(self.build):
            return self.build()
        if not self.build:
            return composed(self.name)
        return self._imported(self.build)()

    def load_part(self) -> Part:
        """Import the part that a robot may be composed of.

        Raises:
            ConfigurationError: this robot is none, or the module of it cannot be imported.
        """
        if not self.part:
            parts = [name for name, entry in robots().entries.items() if entry.part]
            raise ConfigurationError(
                f"robot '{self.name}' is complete, not a part of compositions: take one of {', '.join(parts)}"
            )
        return self._imported(self.part)

    def _imported(self, where: str) -> Any:
        # Imported only now: listing a hundred robots must not load their modules.
        module, _, attribute = where.partition(":")
        with faults_named(f"robot '{self.name}' ({where})"):
            return getattr(importlib.import_module(module), attribute)

    @cached_property
    def dof(self) -> int:
        """Number of joints that move freely, without mimics. Builds the robot."""
        # Counted on the built robot, so that an entry cannot state a wrong number.
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
        """Return the entry of a robot, of a composition such as ``"ur10+allegro_right"``, or of a fitted robot's file.

        The entry of a composition is made of those of its parts. Spaces around names do not count. A name that ends in
        ``.json`` is a file of ``orbit identify``.

        Raises:
            UnknownNameError: there is none of that name.
            AssetError: the file is no fitted robot.
            ConfigurationError: two packages bring it, or a part's name is empty.
        """
        if isinstance(name, str) and name.endswith(".json"):
            return self._fitted(Path(name))
        if not isinstance(name, str) or "+" not in name:
            return self._registry.get(name.strip() if isinstance(name, str) else name)
        # A composition has no entry point: its entry is made on request.
        parts = self.parts(name)
        return RobotEntry(
            name,
            "; ".join(part.description for part in parts),
            lambda: composed(name),
            ", ".join(dict.fromkeys(part.source for part in parts)),
            "; ".join(dict.fromkeys(f"{part.licence} ({part.name})" for part in parts)),
        )

    def _fitted(self, path: Path) -> RobotEntry:
        found = read_fitted(path)
        base = self.entry(found.robot)
        return replace(
            base,
            name=str(path),
            description=f"{base.description}, fitted on {found.backend} to {found.source}",
            build=lambda: found.apply(base.load()),
            source=f"{base.source}; {found.source}",
            part="",
        )

    def parts(self, names: str) -> list[RobotEntry]:
        """Return the entries of the names between plus signs.

        Raises:
            UnknownNameError: there is no robot of a name.
            ConfigurationError: two packages bring one, or a name is empty.
        """
        found: list[RobotEntry] = []
        for name in (part.strip() for part in names.split("+")):
            if not name:
                raise ConfigurationError(
                    f"robot '{names}' has an empty part: name one on either side of each plus sign, as in "
                    "'ur10+robotiq_2f85'"
                )
            if name not in self._registry.names:
                parts = [other for other, entry in self.entries.items() if entry.part]
                raise UnknownNameError("part", name, parts, f"robot '{names}'", self._registry.note)
            found.append(self._registry.get(name))
        return found


def composed(names: str) -> RobotSpec:
    """Compose the robot of the parts whose names are between plus signs, the base first.

    An arm named last mounts its own end effector, if it has one.

    Raises:
        UnknownNameError: there is no robot of a name.
        ConfigurationError: a robot is no part, or the parts cannot be mounted on each other.
        AssetError: the model of a part is not available.
    """
    parts = [entry.load_part() for entry in robots().parts(names)]
    # Named last, an arm is the end of the chain, and carries its default hand.
    if parts[-1].end_effector:
        parts.append(robots().entry(parts[-1].end_effector).load_part())
    return parts[0].composed(names.replace(" ", ""), parts[1:])


@cache
def robots() -> RobotCatalogue:
    """Return the catalogue of all installed robots, read once."""
    return RobotCatalogue()


def robot_names() -> list[str]:
    """Return the names of all installed robots, sorted."""
    return sorted(robots().entries)


def robot_info(name: str) -> RobotEntry:
    """Return description, source, licence and degrees of freedom of a robot.

    Raises:
        UnknownNameError: there is none of that name.
    """
    return robots().entry(name)


def robot(name: str, /, **overrides: Any) -> RobotSpec:
    """Build the robot of that name, with fields of :class:`~orbit_core.scene.RobotSpec` replaced by ``overrides``.

    Raises:
        UnknownNameError: there is no such robot or field.
        AssetError: the package that the model comes from is neither installed nor cached.
    """
    spec = robot_info(name).load()
    # Checked here, because replace would raise a TypeError without the nearest name.
    fields = [field.name for field in dataclasses.fields(spec)]
    for field in overrides:
        if field not in fields:
            raise UnknownNameError("robot field", field, fields, f"robot('{name}', ...)")
    return replace(spec, **overrides)
