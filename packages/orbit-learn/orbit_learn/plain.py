"""Typed dataclasses from plain data, as JSON and TOML give it: every field is checked, and nothing is guessed."""

from __future__ import annotations

import dataclasses
import math
import types
import typing
from typing import Any, TypeVar

from orbit_core.interfaces import ConfigurationError, OrbitError, UnknownNameError

T = TypeVar("T")


def from_plain(kind: type[T], values: Any, where: str) -> T:
    """Return a dataclass from an object of the same fields.

    Fields may be truth values, integers, finite floats, texts, other dataclasses, ``tuple[X, ...]``, ``dict[str, X]``
    and ``X | None``.

    Args:
        kind: the dataclass.
        values: what a file says.
        where: what the values are, for messages.

    Raises:
        UnknownNameError: there is no such field; names the nearest.
        ConfigurationError: a field is missing or of another type, or the dataclass refuses a value.
    """
    if not isinstance(values, dict):
        raise ConfigurationError(f"{where} is {_shown(values)}, not an object")
    fields = {field.name: field for field in dataclasses.fields(typing.cast(Any, kind)) if field.init}
    hints = typing.get_type_hints(kind)
    for name in values:
        if name not in fields:
            raise UnknownNameError("field", _shown(name), fields, where)
    given = {name: _value(hints[name], value, f"{where}.{name}") for name, value in values.items()}
    for name, field in fields.items():
        needed = field.default is dataclasses.MISSING and field.default_factory is dataclasses.MISSING
        if needed and name not in given:
            raise ConfigurationError(f"{where} lacks {name}")
    try:
        return kind(**given)
    except (ValueError, OrbitError) as error:
        raise ConfigurationError(f"{where}: {error}") from None


def _value(hint: Any, value: Any, where: str) -> Any:
    origin, arguments = typing.get_origin(hint), typing.get_args(hint)
    if origin in (types.UnionType, typing.Union):
        others = [argument for argument in arguments if argument is not type(None)]
        return None if value is None else _value(others[0], value, where)
    if dataclasses.is_dataclass(hint):
        return from_plain(typing.cast(type, hint), value, where)
    if origin is tuple and isinstance(value, list):
        return tuple(_value(arguments[0], item, f"{where}[{i}]") for i, item in enumerate(value))
    if origin is dict and isinstance(value, dict):
        return {key: _value(arguments[1], item, f"{where}.{_shown(key)}") for key, item in value.items()}
    if hint is float and type(value) in (int, float) and math.isfinite(value):
        return float(value)
    if hint in (bool, int, str) and type(value) is hint:
        return value
    raise ConfigurationError(f"{where} is {_shown(value)}, not {getattr(hint, '__name__', hint)}")


def _shown(value: Any) -> str:
    """As much of a value as a message should hold."""
    text = repr(value) if not isinstance(value, str) else value
    return text if len(text) <= 60 else text[:57] + "..."
