"""Setting the fields of nested dataclasses by path: ``rewards.lift.weight = 30``.

One set of rules holds for the command line, TOML files and Python keywords. What a field takes is what its annotation
says, read by msgspec; where that says nothing, the kind of its present value.
"""

from __future__ import annotations

import dataclasses
import functools
import inspect
import math
import sys
import tomllib
import types
import typing
from collections.abc import Callable, Iterable, Mapping
from enum import Enum
from pathlib import Path
from typing import Any, TypeVar

import msgspec

from orbit_core.interfaces.errors import ConfigurationError, UnknownNameError

Config = TypeVar("Config")
_LARGEST = 2**31 - 1
"""Largest whole number, for engines hold them in 32 bits."""
_LONGEST_FILE = 2**20
"""Bytes of a TOML file."""
_DEEPEST = 32
"""Levels of tables and lists within each other in a TOML file."""
_OFF = "none"
"""What switches a field off in text, where it may be None."""


@dataclasses.dataclass(frozen=True)
class Text:
    """A value as it was typed, to be read as its field says."""

    text: str


Presets = Mapping[str, Mapping[str, Callable[[], Any]]]
"""Values that words stand for, by field and word."""


def configured(
    config: Config, values: Mapping[str, Any], owner: str, kind: str = "field", presets: Presets | None = None
) -> Config:
    """A copy of a dataclass with some of the fields in it, and in the dataclasses within it, set.

    Args:
        config: an instance; it stays as it is.
        values: by path, ``"rewards.lift.weight"``; a mapping sets fields below its path. Later ones win.
        owner: what ``config`` is called in messages: "task Lift".
        kind: what messages call a field: "setting".
        presets: words that some fields of ``config`` itself take in the place of a value.

    Raises:
        UnknownNameError: there is no such field; tells the nearest.
        ConfigurationError: a value is not what its field takes; names the field by its path.
    """
    paths = [(str(path).split("."), value) for path, value in values.items()]
    return _Owner(owner, kind, presets or {}).set(config, paths, "")


def assignments(pairs: Iterable[str], owner: str, kind: str = "field") -> dict[str, Text]:
    """``path=value`` of the command line, for :func:`configured`.

    Raises:
        ConfigurationError: there is no ``=``.
    """
    values: dict[str, Text] = {}
    for pair in pairs:
        path, equals, text = pair.partition("=")
        if not equals:
            raise ConfigurationError(f"a {kind} of {owner} is set as key=value, not '{pair}'")
        values[path.strip()] = Text(text)
    return values


def read_toml(path: Path, what: str) -> dict[str, Any]:
    """Read a TOML file.

    Args:
        path: of the file.
        what: the file is, for messages: "configuration file".

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
    depth, level = 0, [values]
    while level:
        depth += 1
        inner = [part for each in level for part in (each.values() if isinstance(each, dict) else each)]
        level = [part for part in inner if isinstance(part, dict | list)]
    return depth


def field_types(kind: type) -> dict[str, Any]:
    """The annotations of a dataclass's fields that may be set, by name; Any where one cannot be resolved."""
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
    """What is configured, and what its fields are called in messages."""

    name: str
    kind: str
    presets: Presets

    def set(self, config: Any, paths: _Paths, above: str) -> Any:
        """All at once, so that what a dataclass demands of several fields together is asked of the last values."""
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
    """A value as the field takes it."""
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
        return None  # a file has no other word for it
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
        raise ConfigurationError(f"{what} cannot be set to {text!r}: {_told(branches, present)}")
    lists = [branch for branch in plain if (typing.get_origin(branch) or branch) is tuple]
    if lists and (len(lists) == len(plain) or "," in text):
        parts = [part.strip() for part in text.strip().strip("[]()").split(",")]
        return _converted([part for part in parts if part], plain, what, strict=False, shown=text)
    return _converted(text if str in plain else text.strip(), plain, what, strict=False)


def _converted(value: Any, plain: list[Any], what: str, strict: bool, shown: Any = None) -> Any:
    wanted = functools.reduce(lambda left, right: left | right, plain)
    if isinstance(value, bool) and bool not in plain:
        raise ConfigurationError(f"{what} is {value}, but must be {_words(plain, None)}")
    if isinstance(value, Enum):
        value = value.value
    try:
        return msgspec.convert(value, wanted, strict=strict, dec_hook=lambda kind, text: kind(text))
    except msgspec.ValidationError:
        shown = value if shown is None else shown
        raise ConfigurationError(f"{what} is {shown!r}, but must be {_words(plain, None)}") from None


def _checked(value: Any, what: str) -> Any:
    """Refuse numbers that no engine can hold."""
    for number in value if isinstance(value, tuple | list) else (value,):
        if isinstance(number, int) and abs(number) > _LARGEST:
            raise ConfigurationError(f"{what} is {number}: give at most {_LARGEST}")
        if isinstance(number, float) and not math.isfinite(number):
            raise ConfigurationError(f"{what} is {number}: give a finite number")
    return value


def _branches(hint: Any) -> list[Any]:
    """The kinds that an annotation allows, None left out."""
    if typing.get_origin(hint) is typing.Annotated:
        return _branches(typing.get_args(hint)[0])
    if typing.get_origin(hint) in (typing.Union, types.UnionType):
        return [b for part in typing.get_args(hint) for b in _branches(part) if part is not types.NoneType]
    return [hint]


def _is_plain(branch: Any) -> bool:
    """Whether values of that kind can be typed."""
    if typing.get_origin(branch) is tuple:
        return all(part is Ellipsis or _is_plain(part) for part in typing.get_args(branch))
    return branch in (bool, int, float, str, Path) or (isinstance(branch, type) and issubclass(branch, Enum))


def _is_instance(value: Any, branch: Any) -> bool:
    """Whether a value is of a kind that cannot be typed, such as a dataclass or a mapping."""
    origin = typing.get_origin(branch) or branch
    return not _is_plain(branch) and isinstance(origin, type) and isinstance(value, origin)


def _optional(hint: Any) -> bool:
    return types.NoneType in typing.get_args(hint)


def _off(text: str, hint: Any, present: Any) -> bool:
    """Whether a text switches the field off."""
    return text.strip().lower() == _OFF and (_optional(hint) or (hint is Any and not isinstance(present, str)))


def _told(branches: list[Any], present: Any) -> str:
    """What may be set of a field whose values cannot be typed."""
    if dataclasses.is_dataclass(present):
        return f"set what it holds by its path ({', '.join(field_types(type(present)))})"
    if all(branch in (Any, types.NoneType) for branch in branches):
        return "it is given in Python alone"
    return f"it takes {_words(branches, present)}, which is no text"


def _words(branches: list[Any], present: Any) -> str:
    """How a message calls what a field takes."""
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
