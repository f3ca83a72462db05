"""Named values of one kind, from this program and from the entry points of installed packages.

Entry points are read once, at the first question. A package that is broken, or whose version does not fit, is left out
and named, so that it stops only those who ask for what it would have brought. Two packages that bring one name are both
left out of that name only; a package that brings a name of this program's own is left out of it.
"""

from __future__ import annotations

import dataclasses
import importlib.util
import warnings
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any, Generic, TypeVar

import importlib_metadata

from orbit_core.distributions import check_distribution, missing_note, warn_of_copies
from orbit_core.installing import install_command, upgrade_command
from orbit_core.interfaces.errors import ConfigurationError, OrbitError, UnknownNameError

Value = TypeVar("Value")
EntryPoint = importlib_metadata.EntryPoint


class PluginWarning(UserWarning):
    """An installed package is left out; the message has the reason."""


@dataclass(frozen=True)
class _Origin:
    """Source of a value."""

    description: str
    distribution: str = ""
    """Empty for this program."""


_PROGRAM = _Origin("this program")


class Registry(Generic[Value]):
    """Named values of one kind, from this program and from installed packages.

    An entry point is either one value, under the entry point's own name, and is loaded when that value is requested;
    or, where the registry has a ``read``, it is loaded at the first question and brings any number of values.

    Args:
        kind: Name of the values in messages: "task", "robot".
        group: Entry-point group of packages that bring some.
        read: Function that takes the object of an entry point and adds its values to the registry.
        usable: Predicate of entry points that are one value; the others do not count.
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
        self._origins: dict[str, _Origin] = {}
        self._twice: dict[str, str] = {}
        self._warnings: list[str] = []
        self._adding: tuple[_Origin, dict[str, Callable[[], Value]]] = (_PROGRAM, self._loads)
        self._installed = False

    @property
    def names(self) -> list[str]:
        """Names of all values, in the order in which they were added; nothing is loaded."""
        self._add_installed()
        self._issue_warnings()
        return self._unique_names()

    @property
    def values(self) -> dict[str, Value]:
        """All values by name, loaded."""
        return {name: self._loads[name]() for name in self.names}

    @property
    def note(self) -> str:
        """Reasons why a name may be missing: packages that were left out, and ORBIT's own that is not installed."""
        return "; ".join(filter(None, [*self.faults, missing_note(self.group)]))

    def add(self, name: str, value: Value) -> None:
        """Add a value, from a package's entry point or from a program.

        Raises:
            ConfigurationError: The package, or this program, has added that name before.
        """
        self.add_lazily(name, lambda: value)

    def get(self, name: str) -> Value:
        """Return the value of a name.

        Raises:
            UnknownNameError: There is none; names the nearest, the packages that were left out, and the distribution
                of ORBIT that is missing.
            ConfigurationError: Two packages bring it, or the package that brings it is broken or does not fit.
        """
        self._add_installed()
        # Names come from command lines and files, and may be anything.
        if not isinstance(name, str) or name not in self._loads:
            self._warnings.clear()  # the error names all of them
            raise UnknownNameError(self.kind, name, self._unique_names(), note=self.note)
        # Neither package's value is used: which of the two would otherwise depend on the order of installation.
        if name in self._twice:
            self._warnings.clear()
            raise ConfigurationError(self._twice[name])
        self._issue_warnings()
        return self._loads[name]()

    def origin(self, name: str) -> str:
        """Return a description of the source of a value: its entry point and distribution, or this program."""
        return self._origins[name].description

    def distribution(self, name: str) -> str:
        """Return the name of the distribution that brings a value; empty for this program."""
        return self._origins[name].distribution

    def add_lazily(self, name: str, load: Callable[[], Value]) -> None:
        """Add a value that is made each time it is requested.

        Raises:
            ConfigurationError: The package, or this program, has added that name before.
        """
        origin, loads = self._adding
        if name in loads:
            raise ConfigurationError(self._clash(name, self._origins.get(name, origin), origin))
        loads[name] = load
        if loads is self._loads:
            self._origins[name] = origin

    def _add_installed(self) -> None:
        """Add the values of installed packages, once."""
        if self._installed:
            return
        # Set before the entry points are read: a plugin that asks the registry while it loads must not start again.
        self._installed = True
        warn_of_copies("orbit-core")
        for point in importlib_metadata.entry_points(group=self.group):
            origin = _origin(point)
            if origin.distribution:
                warn_of_copies(origin.distribution)
            if self._read_point is not None:
                self._read(point, origin)
            elif self._usable(point):
                self._merge(origin, {point.name: _loader(f"{self.kind} '{point.name}'", point, origin)})

    def _read(self, point: EntryPoint, origin: _Origin) -> None:
        """Call an entry point that adds its values: all of them are added, or none."""
        assert self._read_point is not None
        # Collected apart, so that a package that fails halfway leaves nothing behind.
        self._adding = origin, {}
        try:
            check_distribution(origin.distribution)
            with faults_named(f"{origin.description} of group {self.group}", origin.distribution):
                self._read_point(point.load())
        except ConfigurationError as error:
            self.faults.append(str(error))
            self._warnings.append(f"{error}; it is left out")
        else:
            self._merge(*self._adding)
        finally:
            self._adding = _PROGRAM, self._loads

    def _merge(self, origin: _Origin, loads: dict[str, Callable[[], Value]]) -> None:
        for name, load in loads.items():
            first = self._origins.get(name)
            if first is None:
                self._loads[name], self._origins[name] = load, origin
                continue
            clash = self._clash(name, first, origin)
            if first is not _PROGRAM:
                self._twice[name] = clash
            # A program that registers a name itself means to replace what a package brings.
            used = "the former is used" if first is _PROGRAM else "neither is used"
            self._warnings.append(f"{clash}; {used}")

    def _unique_names(self) -> list[str]:
        return [name for name in self._loads if name not in self._twice]

    def _issue_warnings(self) -> None:
        """Warn of all that was left out, once, as of the caller of a public method."""
        for warning in self._warnings:
            warnings.warn(warning, PluginWarning, stacklevel=3)
        self._warnings.clear()

    def _clash(self, name: str, first: _Origin, second: _Origin) -> str:
        owners = dict.fromkeys(filter(None, (first.distribution, second.distribution)))
        remedy = "".join(f", or pip uninstall {owner}" for owner in owners)
        return (
            f"{self.kind} '{name}' is registered twice, by {first.description} and by {second.description}: rename one"
            f"{remedy}"
        )


class ClassRegistry(Registry[type[Value]]):
    """Dataclasses of one kind, each under its class variable ``name``; entry points name such classes.

    Args:
        kind: Name of the classes in messages: "motion generator".
        group: Entry-point group of packages that bring some.
        own: Classes of this program.
        base: Class that all of them derive from.
    """

    def __init__(self, kind: str, group: str, own: Iterable[type[Value]], base: type = object) -> None:
        super().__init__(kind, group, self.add_class)
        self._base = base
        for value in own:
            self.add_class(value)

    def add_class(self, value: type[Value]) -> None:
        """Add a class under its own name.

        Raises:
            ConfigurationError: It is no dataclass of this kind, has no name, or the name is taken.
        """
        fits = isinstance(value, type) and issubclass(value, self._base) and dataclasses.is_dataclass(value)
        name = getattr(value, "name", None)
        if not fits or not isinstance(name, str):
            derived = "" if self._base is object else f" of class {self._base.__name__}"
            raise ConfigurationError(f"{self.kind} {value!r} is no dataclass{derived} with a class variable 'name'")
        self.add(name, value)

    @property
    def descriptions(self) -> dict[str, str]:
        """First line of each class's docstring, by the class's name in the registry."""
        return {name: first_line(value) for name, value in self.values.items()}


def first_line(documented: object) -> str:
    """Return the first line of a docstring; empty where there is none."""
    return (documented.__doc__ or "").strip().partition("\n")[0]


@contextmanager
def faults_named(plugin: str, distribution: str = "") -> Iterator[None]:
    """Convert any exception of a plugin's own code, SystemExit included, into an error that names the plugin.

    Args:
        plugin: Description of the plugin.
        distribution: Name of the distribution that brings it, for the remedy; empty if unknown.

    Raises:
        ConfigurationError: The code within raised anything but an interrupt.
    """
    try:
        yield
    except (Exception, SystemExit) as error:  # a package's own fault may be of any class
        what = str(error) if isinstance(error, OrbitError) else f"{type(error).__name__}: {error}"
        raise ConfigurationError(f"{plugin} cannot be loaded ({what}): {_remedy(error, distribution)}") from error


def _remedy(error: BaseException, distribution: str) -> str:
    """Return what to do about a plugin that raised an error."""
    module = (error.name if isinstance(error, ImportError) else None) or ""
    package = module.partition(".")[0]
    # A package that loads, but lacks the module or the name, is of another version than the plugin was written for.
    if package.startswith("orbit_") and distribution and importlib.util.find_spec(package):
        return f"it was written for another version of {package}: {upgrade_command(distribution)}"
    if package.startswith("orbit_") and package == module:
        return install_command(package.replace("_", "-"))
    return f"fix it, or pip uninstall {distribution}" if distribution else "fix or uninstall it"


def _origin(point: EntryPoint) -> _Origin:
    name = point.dist.name if point.dist else ""
    distribution = f", of distribution {name}" if name else ""
    return _Origin(f"entry point '{point.name}' ({point.value}{distribution})", name)


def _loader(value: str, point: EntryPoint, origin: _Origin) -> Callable[[], Any]:
    """Return a function that loads the object of an entry point, for a value described in words."""

    def load() -> Any:
        check_distribution(origin.distribution)
        with faults_named(f"{value}, {origin.description}", origin.distribution):
            return point.load()

    return load
