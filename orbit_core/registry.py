"""What this program and installed packages bring under one entry-point group, by name.

Entry points are read once, at the first question. A package that is broken is left out and named, so that it stops only
those who ask for what it would have brought. Two packages that bring one name are both left out of that name alone; a
package that brings a name of this program's own is left out of it.
"""

from __future__ import annotations

import dataclasses
import warnings
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from typing import Any, Generic, TypeVar

import importlib_metadata

from orbit_core.interfaces.errors import ConfigurationError, OrbitError, UnknownNameError

Value = TypeVar("Value")
EntryPoint = importlib_metadata.EntryPoint
_PROGRAM = "this program"


class PluginWarning(UserWarning):
    """An installed package is left out, for a reason of its own."""


class Registry(Generic[Value]):
    """Named values of one kind, from this program and from installed packages.

    An entry point either stands for one value, under the entry point's own name, and is loaded when that value is asked
    for; or, where the registry has a ``read``, it is loaded at the first question and brings any number of values.

    Args:
        kind: what the values are called in messages: "task", "robot".
        group: the entry-point group of packages that bring some.
        read: takes what an entry point names and adds its values to the registry.
        usable: tells whether an entry point that stands for one value is to be had; others do not count.
    """

    def __init__(
        self,
        kind: str,
        group: str,
        read: Callable[[Any], None] | None = None,
        usable: Callable[[EntryPoint], bool] = lambda point: True,
    ) -> None:
        self.kind = kind
        self.group = group
        self.faults: list[str] = []
        """One sentence about each package that was left out."""
        self._read_point = read
        self._usable = usable
        self._loads: dict[str, Callable[[], Value]] = {}
        self._origins: dict[str, str] = {}
        self._twice: dict[str, str] = {}
        self._adding: tuple[str, dict[str, Callable[[], Value]]] = (_PROGRAM, self._loads)
        self._installed = False

    @property
    def names(self) -> list[str]:
        """Everything that can be asked for, as it was added; nothing is loaded."""
        self._add_installed()
        return [name for name in self._loads if name not in self._twice]

    @property
    def values(self) -> dict[str, Value]:
        """Everything that can be had, by name."""
        return {name: self._loads[name]() for name in self.names}

    def add(self, name: str, value: Value) -> None:
        """Add a value, from a package's entry point or from a program.

        Raises:
            ConfigurationError: the package, or this program, has added that name before.
        """
        self.add_lazily(name, lambda: value)

    def get(self, name: str) -> Value:
        """The value of that name.

        Raises:
            UnknownNameError: there is none; tells the nearest, and which packages were left out.
            ConfigurationError: two packages bring it, or the package that brings it is broken.
        """
        names = self.names
        if not isinstance(name, str) or name not in self._loads:
            raise UnknownNameError(self.kind, name, names, note="; ".join(self.faults))
        if name in self._twice:
            raise ConfigurationError(self._twice[name])
        return self._loads[name]()

    def origin(self, name: str) -> str:
        """Who brings the value of that name, in words."""
        return self._origins[name]

    def add_lazily(self, name: str, load: Callable[[], Value]) -> None:
        """Add a value that is made whenever it is asked for.

        Raises:
            ConfigurationError: the package, or this program, has added that name before.
        """
        origin, loads = self._adding
        if name in loads:
            raise ConfigurationError(self._clash(name, self._origins.get(name, origin), origin))
        loads[name] = load
        if loads is self._loads:
            self._origins[name] = origin

    def _add_installed(self) -> None:
        """Add what installed packages bring, as the first question does; warns of each that is left out."""
        if self._installed:
            return
        self._installed = True
        for point in importlib_metadata.entry_points(group=self.group):
            if self._read_point is None:
                if self._usable(point):
                    self._merge(described(point), {point.name: _loader(self.kind, point)})
            else:
                self._read(point)

    def _read(self, point: EntryPoint) -> None:
        """Let an entry point add its values: all of them, or none."""
        assert self._read_point is not None
        origin = described(point)
        self._adding = origin, {}
        try:
            with faults_named(f"{origin} of group {self.group}"):
                self._read_point(point.load())
        except ConfigurationError as error:
            self.faults.append(str(error))
            warnings.warn(f"{error}; it is left out", PluginWarning, stacklevel=4)
        else:
            self._merge(*self._adding)
        finally:
            self._adding = _PROGRAM, self._loads

    def _merge(self, origin: str, loads: dict[str, Callable[[], Value]]) -> None:
        for name, load in loads.items():
            first = self._origins.get(name)
            if first is None:
                self._loads[name], self._origins[name] = load, origin
                continue
            clash = self._clash(name, first, origin)
            if first != _PROGRAM:
                self._twice[name] = clash
            used = "the former is used" if first == _PROGRAM else "neither is used"
            warnings.warn(f"{clash}; {used}", PluginWarning, stacklevel=5)

    def _clash(self, name: str, first: str, second: str) -> str:
        return (
            f"{self.kind} '{name}' is registered twice, by {first} and by {second}: rename one, or uninstall one of "
            "the two packages"
        )


class ClassRegistry(Registry[type[Value]]):
    """Dataclasses of one kind, each under the class variable ``name`` that it has; entry points name such classes.

    Args:
        kind: what the classes are called in messages: "motion generator".
        group: the entry-point group of packages that bring some.
        own: those of this program.
        base: class that all of them derive from.
    """

    def __init__(self, kind: str, group: str, own: Iterable[type[Value]], base: type = object) -> None:
        super().__init__(kind, group, self.add_class)
        self._base = base
        for value in own:
            self.add_class(value)

    def add_class(self, value: type[Value]) -> None:
        """Add a class under its own name.

        Raises:
            ConfigurationError: it is no dataclass of this kind, has no name, or the name is taken.
        """
        fits = isinstance(value, type) and issubclass(value, self._base) and dataclasses.is_dataclass(value)
        name = getattr(value, "name", None)
        if not fits or not isinstance(name, str):
            derived = "" if self._base is object else f" of class {self._base.__name__}"
            raise ConfigurationError(f"{self.kind} {value!r} is no dataclass{derived} with a class variable 'name'")
        self.add(name, value)

    @property
    def descriptions(self) -> dict[str, str]:
        """The first line of each class's docstring, by the class's name in the registry."""
        return {name: first_line(value) for name, value in self.values.items()}


def first_line(documented: object) -> str:
    """The first line of a docstring; nothing where there is none."""
    return (documented.__doc__ or "").strip().partition("\n")[0]


def described(point: EntryPoint) -> str:
    """An entry point in words, with the distribution that it belongs to."""
    distribution = f", of distribution {point.dist.name}" if point.dist else ""
    return f"entry point '{point.name}' ({point.value}{distribution})"


@contextmanager
def faults_named(plugin: str) -> Iterator[None]:
    """Whatever a plugin's own code raises, an attempt to end the process included, as an error that names the plugin.

    Raises:
        ConfigurationError: the code within raised anything but an interrupt.
    """
    try:
        yield
    except (Exception, SystemExit) as error:  # a package's own fault may be of any class
        what = str(error) if isinstance(error, OrbitError) else f"{type(error).__name__}: {error}"
        raise ConfigurationError(f"{plugin} cannot be loaded ({what}): mend or uninstall it") from error


def _loader(kind: str, point: EntryPoint) -> Callable[[], Any]:
    """Loads what an entry point names."""

    def load() -> Any:
        with faults_named(f"{kind} '{point.name}', {described(point)}"):
            return point.load()

    return load
