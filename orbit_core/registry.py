"""What installed packages bring under one entry-point group, by name.

A package that is broken is left out and named, so that it stops only those who ask for what it would have brought. Two
packages that bring one name are both left out of that name alone.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any, Generic, TypeVar

import importlib_metadata

from orbit_core.interfaces.errors import ConfigurationError, OrbitError, UnknownNameError

Value = TypeVar("Value")
EntryPoint = importlib_metadata.EntryPoint


class PluginWarning(UserWarning):
    """An installed package is left out, for a reason of its own."""


class Registry(Generic[Value]):
    """Named values of one kind, from this program and from installed packages.

    Args:
        kind: what the values are called in messages: "task", "robot".
        group: the entry-point group of packages that bring some.
        read: takes what an entry point names and adds its values to the registry.
    """

    def __init__(self, kind: str, group: str, read: Callable[[Any], None]) -> None:
        self.kind = kind
        self.group = group
        self.faults: list[str] = []
        """One sentence about each package that was left out."""
        self._read = read
        self._values: dict[str, Value] = {}
        self._origins: dict[str, str] = {}
        self._twice: dict[str, str] = {}
        self._adding: tuple[str, dict[str, Value]] = ("this program", self._values)

    @property
    def values(self) -> dict[str, Value]:
        """Everything that can be had, by name."""
        return {name: value for name, value in self._values.items() if name not in self._twice}

    def add(self, name: str, value: Value) -> None:
        """Add a value, from a package's entry point or from a program.

        Raises:
            ConfigurationError: the package, or this program, has added that name before.
        """
        origin, values = self._adding
        if name in values:
            raise ConfigurationError(self._clash(name, self._origins.get(name, origin), origin))
        values[name] = value
        if values is self._values:
            self._origins[name] = origin

    def add_installed(self) -> None:
        """Add what installed packages bring; warns of each that is left out."""
        for point in importlib_metadata.entry_points(group=self.group):
            origin = described(point)
            self._adding = origin, {}
            try:
                with faults_named(f"{origin} of group {self.group}"):
                    self._read(point.load())
            except ConfigurationError as error:
                self.faults.append(str(error))
                warnings.warn(f"{error}; it is left out", PluginWarning, stacklevel=2)
            else:
                self._merge(*self._adding)
            finally:
                self._adding = "this program", self._values

    def get(self, name: str) -> Value:
        """The value of that name.

        Raises:
            UnknownNameError: there is none; tells the nearest, and which packages were left out.
            ConfigurationError: two packages bring it.
        """
        if not isinstance(name, str) or name not in self._values:
            raise UnknownNameError(self.kind, name, self.values, note="; ".join(self.faults))
        if name in self._twice:
            raise ConfigurationError(self._twice[name])
        return self._values[name]

    def _merge(self, origin: str, values: dict[str, Value]) -> None:
        for name, value in values.items():
            if name in self._values:
                self._twice[name] = self._clash(name, self._origins[name], origin)
                warnings.warn(f"{self._twice[name]}; neither is used", PluginWarning, stacklevel=3)
            else:
                self._values[name], self._origins[name] = value, origin

    def _clash(self, name: str, first: str, second: str) -> str:
        return (
            f"{self.kind} '{name}' is registered twice, by {first} and by {second}: rename one, or uninstall one of "
            "the two packages"
        )


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
