"""``key=value`` of the command line, turned into the type of what the key is by default."""

from __future__ import annotations

import dataclasses
import tomllib
from collections.abc import Mapping, Sequence
from typing import Any

from orbit_core.interfaces.errors import ConfigurationError, UnknownNameError


def defaults_of(kind: type) -> dict[str, Any]:
    """The fields of a dataclass that hold a number, text, truth value or tuple by default."""
    return {
        field.name: field.default
        for field in dataclasses.fields(kind)
        if field.init and isinstance(field.default, bool | int | float | str | tuple)
    }


def check_values(values: Mapping[str, Any], defaults: Mapping[str, Any], kind: str, owner: str) -> dict[str, Any]:
    """Values of a file, each of the type of its default.

    Args:
        values: by key.
        defaults: by key; what may be set.
        kind: what messages call a key.
        owner: what the keys belong to, for messages.

    Raises:
        ConfigurationError: a value is not of its default's type.
        UnknownNameError: a key is unknown; names the nearest.
    """
    for key in values:
        if key not in defaults:
            raise UnknownNameError(kind, key, defaults, owner)
    return {key: _checked(key, value, defaults[key], owner) for key, value in values.items()}


def parse_values(pairs: Sequence[str], defaults: Mapping[str, Any], kind: str, owner: str) -> dict[str, Any]:
    """The same from texts ``key=value`` of the command line.

    Raises:
        ConfigurationError: a pair has no ``=``, or a value is not of its default's type.
        UnknownNameError: a key is unknown; names the nearest.
    """
    values: dict[str, Any] = {}
    for pair in pairs:
        key, equals, text = pair.partition("=")
        if not equals:
            raise ConfigurationError(f"a {kind} of {owner} is set as key=value, not '{pair}'")
        values[key] = _value(text, defaults.get(key))
    return check_values(values, defaults, kind, owner)


def _value(text: str, default: Any) -> Any:
    """The text read as TOML, as far as it is; a tuple may be written without brackets."""
    if isinstance(default, str):
        return text
    literal = f"[{text}]" if isinstance(default, tuple) and not text.startswith("[") else text
    try:
        return tomllib.loads(f"value = {literal}")["value"]
    except tomllib.TOMLDecodeError:
        return text


def _checked(key: str, value: Any, default: Any, owner: str) -> Any:
    if isinstance(default, tuple) and isinstance(value, list | tuple):
        item = default[0] if default else 0.0
        return tuple(_checked(key, part, item, owner) for part in value)
    if isinstance(default, float) and type(value) is int:
        return float(value)
    if type(value) is not type(default):
        raise ConfigurationError(
            f"{key} = {value!r} of {owner} must be of the type of its default {default!r}, {type(default).__name__}"
        )
    return value
