"""Dataclasses read from text, files and keywords, and checked against the annotations of their fields.

:func:`configured` sets fields of nested dataclasses by path, ``rewards.lift.weight = 30``: the same rules hold for the
command line, TOML files and Python keywords. :func:`from_plain` makes a dataclass of what a JSON file holds.
:class:`TypeChecker` checks instances that a program made. What a field takes is what its annotation says; where that
says nothing, the kind of its present value.
"""

from __future__ import annotations

import contextlib
import dataclasses
import functools
import inspect
import math
import numbers
import sys
import tomllib
import types
import typing
from collections.abc import Callable, Iterable, Mapping, Sequence
from enum import Enum
from pathlib import Path
from typing import Any, TypeVar

import msgspec

from orbit_core.interfaces.errors import ArgumentError, ConfigurationError, OrbitError, UnknownNameError

Config = TypeVar("Config")
# Largest whole number: engines hold them in 32 bits
_LARGEST = 2**31 - 1
# Bytes of a TOML file
_LONGEST_FILE = 2**20
# Levels of tables and lists within each other in a TOML file
_DEEPEST = 32
# Word that switches a field off in text, where the field may be None
_OFF = "none"
# Characters of a value that a message shows
_SHOWN = 80


@dataclasses.dataclass(frozen=True)
class Text:
    """A value as it was typed, to be read as its field says."""

    text: str
    """Characters as they were typed, without quotes."""


Presets = Mapping[str, Mapping[str, Callable[[], Any]]]
"""Values that words are short for, by field and word."""


def configured(
    config: Config, values: Mapping[str, Any], owner: str, kind: str = "field", presets: Presets | None = None
) -> Config:
    """Return a copy of a dataclass with some fields set, in it and in the dataclasses within it.

    Args:
        config: an instance; it stays as it is.
        values: by path, ``"rewards.lift.weight"``; a mapping sets fields below its path. Later ones win.
        owner: name of ``config`` in messages: "task Lift".
        kind: name of a field in messages: "setting".
        presets: words that some fields of ``config`` itself take in the place of a value.

    Raises:
        UnknownNameError: there is no such field; names the nearest.
        ConfigurationError: a value is not of the kind that its field takes; names the field by its path.
    """
    # Split once here; below, paths are lists of names.
    paths = [(str(path).split("."), value) for path, value in values.items()]
    return _Owner(owner, kind, presets or {}).set(config, paths, "")


def settings_table(values: Mapping[str, Any] | None, owner: str) -> dict[str, Any]:
    """Return settings that a program gave, by field; none for None.

    Args:
        values: the settings.
        owner: of the settings, for messages.

    Raises:
        ConfigurationError: they are no dictionary.
    """
    if values is not None and not isinstance(values, Mapping):
        raise ConfigurationError(f"settings of {owner} are a dictionary by field, not a {type(values).__name__}")
    return dict(values or {})


def assignments(pairs: Iterable[str], owner: str, kind: str = "field") -> dict[str, Text]:
    """Split ``path=value`` words of the command line for :func:`configured`.

    Args:
        pairs: the words.
        owner: of the fields, for messages.
        kind: name of a field in messages.

    Raises:
        ConfigurationError: a word has no ``=``.
    """
    values: dict[str, Text] = {}
    for pair in pairs:
        path, equals, text = pair.partition("=")
        if not equals:
            raise ConfigurationError(f"a {kind} of {owner} is set as key=value, not '{pair}'")
        values[path.strip()] = Text(text)
    return values


def from_plain(kind: type[Config], values: Any, where: str) -> Config:
    """Return a dataclass from the plain data of a JSON object with the same fields; nothing is guessed.

    Fields may be truth values, integers, finite floats, texts, other dataclasses, ``tuple[X, ...]``, ``dict[str, X]``
    and ``X | None``.

    Args:
        kind: the dataclass.
        values: content of a file.
        where: name of the values in messages.

    Raises:
        UnknownNameError: there is no such field; names the nearest.
        ConfigurationError: a field is missing or of another type, or the dataclass rejects a value.
    """
    if not isinstance(values, dict):
        raise ConfigurationError(f"{where} is {_shown(values)}, not an object")
    known = field_types(kind)
    for name in values:
        if name not in known:
            raise UnknownNameError("field", str(name)[:_SHOWN], known, where)
    for field in dataclasses.fields(typing.cast(Any, kind)):
        needed = field.default is dataclasses.MISSING and field.default_factory is dataclasses.MISSING
        if needed and field.name not in values:
            raise ConfigurationError(f"{where} lacks {field.name}")
    read = {name: _from_plain(value, known[name], f"{where}.{name}") for name, value in values.items()}
    try:
        return kind(**read)
    except (ValueError, OrbitError) as error:
        raise ConfigurationError(f"{where}: {error}") from None


def _from_plain(value: Any, hint: Any, what: str) -> Any:
    if value is None and _optional(hint):
        return None
    branch = _branches(hint)[0]
    arguments = typing.get_args(branch)
    if dataclasses.is_dataclass(branch):
        return from_plain(typing.cast(type, branch), value, what)
    if typing.get_origin(branch) is tuple and isinstance(value, list):
        return tuple(_from_plain(part, arguments[0], f"{what}[{index}]") for index, part in enumerate(value))
    if typing.get_origin(branch) is dict and isinstance(value, dict):
        return {key: _from_plain(part, arguments[1], f"{what}.{str(key)[:_SHOWN]}") for key, part in value.items()}
    read = _converted(value, [branch], what, strict=True)
    if isinstance(read, float) and not math.isfinite(read):  # JSON has no word for infinity, but 1e999 is read as one
        raise ConfigurationError(f"{what} is {read}: give a finite number")
    return read


def read_toml(path: Path, what: str) -> dict[str, Any]:
    """Read a TOML file.

    Args:
        path: of the file.
        what: name of the file in messages: "configuration file".

    Raises:
        ConfigurationError: it cannot be read, is no regular file, larger than 1 MiB, not TOML, or nests too deep.
    """
    try:
        if path.exists() and not path.is_file():  # a pipe or a device may never end
            raise ConfigurationError(f"{what} {path} is no regular file")
        with path.open("rb") as file:
            data = file.read(_LONGEST_FILE + 1)
    except OSError as error:
        raise ConfigurationError(f"cannot read {what} {path}: {error.strerror}") from error
    except ValueError as error:  # a null character in the name
        raise ConfigurationError(f"cannot read {what} {str(path)!r}: {error}") from error
    if len(data) > _LONGEST_FILE:
        raise ConfigurationError(f"{what} {path} is larger than {_LONGEST_FILE:,} bytes, the most that is read")
    try:
        values = tomllib.loads(data.decode())
    except ValueError as error:  # of syntax, of characters, and of integers of thousands of digits
        raise ConfigurationError(f"{what} {path} is not TOML: {error}") from error
    except RecursionError:
        values = None
    if values is None or _depth(values) > _DEEPEST:
        raise ConfigurationError(f"{what} {path} nests deeper than {_DEEPEST} levels, the most that is read")
    return values


def _depth(values: Any) -> int:
    """Return how deep tables and lists nest, counted without recursion."""
    # Level by level: a recursive count would hit the very limit that it looks for.
    depth, level = 0, [values]
    while level:
        depth += 1
        inner = [part for each in level for part in (each.values() if isinstance(each, dict) else each)]
        level = [part for part in inner if isinstance(part, dict | list)]
    return depth


def field_types(kind: type) -> dict[str, Any]:
    """Return the annotations of a dataclass's fields that may be set, by name; Any where one cannot be resolved."""
    return {field.name: _annotation(kind, field.name) for field in dataclasses.fields(kind) if field.init}


@functools.cache
def _annotation(kind: type, name: str) -> Any:
    owner = next(base for base in kind.__mro__ if name in inspect.get_annotations(base))
    alone = types.SimpleNamespace(__annotations__={name: inspect.get_annotations(owner)[name]})
    try:
        return typing.get_type_hints(alone, vars(sys.modules[owner.__module__]), dict(vars(owner)))[name]
    except NameError:  # imported for type checkers alone, or local to a function
        return Any


_Paths = list[tuple[list[str], Any]]


@dataclasses.dataclass(frozen=True)
class _Owner:
    """Name of a configured object, and the name of its fields in messages."""

    name: str
    kind: str
    presets: Presets

    def set(self, config: Any, paths: _Paths, above: str) -> Any:
        # All fields are replaced at once: a dataclass may demand something of several of them together.
        known, changes = field_types(type(config)), dict[str, Any]()
        for (name, *rest), value in paths:
            if name not in known:
                raise UnknownNameError(self.kind, name, known, f"'{above[:-1]}' of {self.name}" if above else self.name)
            present = changes.get(name, getattr(config, name))
            if rest or (isinstance(value, Mapping) and dataclasses.is_dataclass(present)):
                below = [(rest, value)] if rest else [(str(key).split("."), part) for key, part in value.items()]
                changes[name] = self._set_below(present, below, f"{above}{name}")
            else:
                what = f"{self.kind} '{above}{name}' of {self.name}"
                # Presets belong to fields of the configured object itself, not to those below.
                words = {} if above else self.presets.get(name, {})
                changes[name] = _read(value, present, known[name], words, what)
        try:
            return dataclasses.replace(config, **changes) if changes else config
        except (TypeError, ValueError) as error:
            place = f"'{above[:-1]}' of {self.name}" if above else self.name
            raise ConfigurationError(f"{place}: {error}") from error

    def _set_below(self, present: Any, below: _Paths, where: str) -> Any:
        if not dataclasses.is_dataclass(present) or isinstance(present, type):
            path = ".".join((where, *below[0][0]))
            raise ConfigurationError(
                f"{self.kind} '{where}' of {self.name} is {present!r}, with nothing below it: '{path}' cannot be set"
            )
        return self.set(present, below, f"{where}.")


def _read(value: Any, present: Any, hint: Any, words: Mapping[str, Callable[[], Any]], what: str) -> Any:
    """Return a value as the field takes it, or raise an error that names the field."""
    chosen = value.text if isinstance(value, Text) else value
    if words and isinstance(chosen, str) and not _off(chosen, hint, present):
        if chosen not in words:
            raise UnknownNameError("preset", chosen, words, what)
        return words[chosen]()
    if isinstance(value, Text):
        return _checked(_from_text(value.text, hint, present, what), what)
    branches = _branches(hint)
    if (value is None and _optional(hint)) or hint is Any or any(_is_instance(value, branch) for branch in branches):
        return value
    if isinstance(value, str) and str not in branches and _off(value, hint, present):
        return None  # TOML has no null
    plain = [branch for branch in branches if _is_plain(branch)]
    if not plain:
        raise ConfigurationError(f"{what} is {value!r}, but must be {_words(branches, present)}")
    return _checked(_converted(value, plain, what, strict=True), what)


def _from_text(text: str, hint: Any, present: Any, what: str) -> Any:
    if _off(text, hint, present):
        return None
    branches = [type(present)] if hint is Any and present is not None else _branches(hint)
    plain = [branch for branch in branches if _is_plain(branch)]
    if not plain:
        raise ConfigurationError(f"{what} cannot be set to {text!r}: {_remedy(branches, present)}")
    lists = [branch for branch in plain if (typing.get_origin(branch) or branch) is tuple]
    if lists and (len(lists) == len(plain) or "," in text):
        parts = [part.strip() for part in text.strip().strip("[]()").split(",")]
        return _converted([part for part in parts if part], plain, what, strict=False, shown=text)
    return _converted(text if str in plain else text.strip(), plain, what, strict=False)


def _converted(value: Any, plain: list[Any], what: str, strict: bool, shown: Any = None) -> Any:
    wanted = functools.reduce(lambda left, right: left | right, plain)
    # msgspec would take True for 1, as Python does.
    if isinstance(value, bool) and bool not in plain and Any not in plain:
        raise ConfigurationError(f"{what} is {value}, but must be {_words(plain, None)}")
    if isinstance(value, Enum):
        value = value.value
    try:
        return msgspec.convert(value, wanted, strict=strict, dec_hook=lambda kind, text: kind(text))
    except msgspec.ValidationError:
        shown = value if shown is None else shown
        raise ConfigurationError(f"{what} is {_shown(shown)}, but must be {_words(plain, None)}") from None


def _checked(value: Any, what: str) -> Any:
    """Reject numbers that no engine can hold."""
    for number in value if isinstance(value, tuple | list) else (value,):
        # Engines count in 32 bits, and a larger number would wrap around in silence.
        if isinstance(number, int) and abs(number) > _LARGEST:
            raise ConfigurationError(f"{what} is {number}: give at most {_LARGEST}")
        if isinstance(number, float) and not math.isfinite(number):
            raise ConfigurationError(f"{what} is {number}: give a finite number")
    return value


def _branches(hint: Any) -> list[Any]:
    """Return the types that an annotation allows, None left out."""
    if typing.get_origin(hint) in (typing.Union, types.UnionType):
        return [b for part in typing.get_args(hint) for b in _branches(part) if part is not types.NoneType]
    return [hint]


def _is_plain(branch: Any) -> bool:
    """Return True if values of that type can be typed on a command line."""
    if typing.get_origin(branch) is tuple:
        return all(part is Ellipsis or _is_plain(part) for part in typing.get_args(branch))
    return branch in (bool, int, float, str, Path) or (isinstance(branch, type) and issubclass(branch, Enum))


def _is_instance(value: Any, branch: Any) -> bool:
    """Return True if a value is of a type that cannot be typed, such as a dataclass or a mapping."""
    origin = typing.get_origin(branch) or branch
    return not _is_plain(branch) and isinstance(origin, type) and isinstance(value, origin)


def _optional(hint: Any) -> bool:
    return types.NoneType in typing.get_args(hint)


def _off(text: str, hint: Any, present: Any) -> bool:
    """Return True if a text switches the field off."""
    return text.strip().lower() == _OFF and (_optional(hint) or (hint is Any and not isinstance(present, str)))


def _remedy(branches: list[Any], present: Any) -> str:
    """Return what may be set of a field whose values cannot be typed."""
    if dataclasses.is_dataclass(present):
        return f"set what it holds by its path ({', '.join(field_types(type(present)))})"
    if all(branch in (Any, types.NoneType) for branch in branches):
        return "it is given in Python only"
    return f"it takes {_words(branches, present)}, which is no text"


def _words(branches: list[Any], present: Any) -> str:
    """Return the words of a message for what a field takes."""
    if branches == [Any]:
        return f"a {type(present).__name__}"
    return " or ".join(dict.fromkeys(_word(branch) for branch in branches))


def _word(branch: Any) -> str:
    names = {bool: "true or false", int: "a whole number", float: "a number", str: "text", Path: "text"}
    if branch in names:
        return names[branch]
    origin = typing.get_origin(branch)
    if isinstance(origin, type) and issubclass(origin, Mapping):
        return "a table"
    if origin is tuple:
        parts = typing.get_args(branch)
        if len(parts) == 2 and parts[1] is Ellipsis:
            return f"a list, each part {_word(parts[0])}"
        return f"a list of {len(parts)} ({', '.join(map(_word, parts))})"
    if isinstance(branch, type) and issubclass(branch, Enum):
        return " or ".join(repr(member.value) for member in branch)
    return f"a {getattr(branch, '__name__', branch)}"


Check = Callable[[Any, str], None]
"""Checks a value; raises an error that names the place given."""
Rules = Mapping[type, Check]
"""Checks of dataclasses, by class, that follow those of their fields' types."""


class TypeChecker:
    """Checks dataclasses, and the dataclasses within them, against their annotations.

    Args:
        rules: further checks of some of them.
    """

    def __init__(self, rules: Rules | None = None) -> None:
        self._rules = rules or {}
        self._checks: dict[Any, Check] = {}
        self._fields: dict[type, list[tuple[str, Check]]] = {}

    def check(self, thing: object, where: str) -> None:
        """Check all fields. NaN is no number, lists and arrays count as tuples, whole numbers as real ones.

        Args:
            thing: an instance of a dataclass.
            where: its name, for the message.

        Raises:
            ArgumentError: names the field by its path from ``where``, its value and what it takes.
        """
        with contextlib.suppress(ArgumentError):
            # Most instances are sound, and writing the paths of their fields takes longer than all checks.
            self._dataclass(thing, "")
            return
        self._dataclass(thing, where)

    def check_value(self, value: object, hint: Any, where: str) -> None:
        """Check one value against a type, as :meth:`check` does with fields.

        Args:
            value: anything.
            hint: the type, as ``typing.get_type_hints`` gives it.
            where: the value's name, for the message.

        Raises:
            ArgumentError: as :meth:`check`.
        """
        self._of(hint)(value, where)

    def _dataclass(self, thing: object, where: str) -> None:
        kind = type(thing)
        fields = self._fields.get(kind)
        if fields is None:
            fields = self._fields[kind] = [(name, self._of(hint)) for name, hint in field_types(kind).items()]
        for name, check in fields:
            check(getattr(thing, name), where and f"{where}.{name}")
        rule = self._rules.get(kind)
        if rule is not None:
            rule(thing, where)

    def _of(self, hint: Any) -> Check:
        """Return the check of a type, made once."""
        if hint not in self._checks:
            self._checks[hint] = self._make(hint)
        return self._checks[hint]

    def _make(self, hint: Any) -> Check:
        import numpy as np  # only checks need it, and commands that list names start without

        branches, optional = _branches(hint), _optional(hint)
        if optional or len(branches) > 1:
            return self._union(branches, optional)
        origin, arguments = typing.get_origin(hint), typing.get_args(hint)
        if origin is tuple:
            return self._tuple(arguments)
        if origin is not None and isinstance(origin, type) and issubclass(origin, Mapping):
            return self._mapping(*arguments)
        if origin is np.ndarray:
            return _check_array
        return self._plain(hint) if isinstance(hint, type) else _check_nothing

    def _union(self, branches: Sequence[Any], optional: bool) -> Check:
        kinds = tuple(branch for branch in branches if isinstance(branch, type) and dataclasses.is_dataclass(branch))
        others = [self._of(each) for each in branches if each not in kinds]

        def check(value: Any, where: str) -> None:
            if value is None and optional:
                return None
            if isinstance(value, kinds):
                self._dataclass(value, where)
                return None
            if not others:
                raise wrong_value(where, value, " or ".join(kind.__name__ for kind in kinds))
            refusals: list[ArgumentError] = []
            for other in others:
                try:
                    return other(value, where)
                except ArgumentError as refusal:
                    refusals.append(refusal)
            raise refusals[0]

        return check

    def _tuple(self, parts: Sequence[Any]) -> Check:
        import numpy as np

        repeated = len(parts) == 2 and parts[1] is Ellipsis
        checks = [self._of(part) for part in parts if part is not Ellipsis]

        def check(value: Any, where: str) -> None:
            if not isinstance(value, tuple | Sequence | np.ndarray) or isinstance(value, str | bytes):
                raise wrong_value(where, value, "a tuple")
            if not repeated and len(value) != len(checks):
                raise wrong_value(where, value, f"{len(checks)} of them")
            for index, part in enumerate(value):
                checks[0 if repeated else index](part, where and f"{where}[{_key(part, index)}]")

        return check

    def _mapping(self, key_hint: Any, part_hint: Any) -> Check:
        check_key, check_part = self._of(key_hint), self._of(part_hint)

        def check(value: Any, where: str) -> None:
            if not isinstance(value, Mapping):
                raise wrong_value(where, value, "a dictionary")
            for key, part in value.items():
                check_key(key, f"a key of {where}")
                check_part(part, f"{where}[{key!r}]")

        return check

    def _plain(self, hint: type) -> Check:
        if hint is float:
            return _check_number
        if hint is int:
            return _check_whole_number
        if hint is bool:
            return _check_truth
        named = hint is str or issubclass(hint, Enum) or dataclasses.is_dataclass(hint)

        def check(value: Any, where: str) -> None:
            if named and not isinstance(value, hint):
                raise wrong_value(where, value, f"a {hint.__name__}")
            if not isinstance(value, type) and dataclasses.is_dataclass(value):
                self._dataclass(value, where)

        return check


def _key(part: Any, index: int) -> str:
    """Return the name of a part, which says more than its place, or its place where it has none."""
    name = getattr(part, "name", "")
    return repr(name) if isinstance(name, str) and name and dataclasses.is_dataclass(part) else str(index)


def _check_nothing(value: Any, where: str) -> None:
    """Accept any value: the type says nothing about values."""


def _check_number(value: Any, where: str) -> None:
    if type(value) is float and value == value:
        return
    if isinstance(value, bool) or not isinstance(value, numbers.Real) or math.isnan(value):
        raise wrong_value(where, value, _word(float))


def _check_whole_number(value: Any, where: str) -> None:
    if isinstance(value, bool) or not isinstance(value, numbers.Integral):
        raise wrong_value(where, value, _word(int))


def _check_truth(value: Any, where: str) -> None:
    import numpy as np

    if not isinstance(value, bool | np.bool_):
        raise wrong_value(where, value, _word(bool))


def _check_array(value: Any, where: str) -> None:
    import numpy as np

    if not isinstance(value, np.ndarray) or value.dtype.kind not in "fiu":
        raise wrong_value(where, value, "an array of real numbers")
    if np.isnan(value).any():
        raise ArgumentError(f"{where} holds NaN: give numbers")


def wrong_value(where: str, value: object, wanted: str) -> ArgumentError:
    """Return the error of a value that a field does not take.

    Args:
        where: name of the field.
        value: that it was given.
        wanted: what it takes, in words.
    """
    shown = repr(value)
    return ArgumentError(f"{where} is {shown if len(shown) < _SHOWN else type(value).__name__}: give {wanted}")


def _shown(value: Any) -> str:
    """Return as much of a value as a message should hold."""
    text = repr(value)
    return text if len(text) <= _SHOWN else f"{text[: _SHOWN - 3]}..."
