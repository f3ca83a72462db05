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


def overridden(
    base: Mapping[str, Any], pairs: Sequence[str], defaults: Mapping[str, Any], option: str, owner: str
) -> dict[str, Any]:
    """``base`` with each ``key=value`` over it; all values of the types of ``defaults``.

    Args:
        base: values from a file.
        pairs: from the command line.
        defaults: by key; what may be set.
        option: that the pairs came with, for messages.
        owner: what the keys belong to, for messages.

    Raises:
        ConfigurationError: a pair has no ``=``, or a value is not of its default's type.
        UnknownNameError: a key is unknown; names the nearest.
    """
    values = dict(base)
    for pair in pairs:
        key, equals, text = pair.partition("=")
        if not equals:
            raise ConfigurationError(f"{option} takes key=value, not '{pair}'")
        if key not in defaults:
            raise UnknownNameError("field", key, defaults, owner)
        values[key] = _value(text, defaults[key])
    for key, value in values.items():
        if key not in defaults:
            raise UnknownNameError("field", key, defaults, owner)
        values[key] = _checked(key, value, defaults[key], owner)
    return values


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
