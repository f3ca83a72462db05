"""Values of settings' fields, held to the kind of their defaults, the same way everywhere."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

from orbit_core.interfaces.errors import ConfigurationError

_LARGEST = 2**31 - 1
"""Of whole numbers, which engines hold in 32 bits."""


def settings_table(values: Mapping[str, Any] | None, owner: str) -> dict[str, Any]:
    """Settings by field, none for None.

    Raises:
        ConfigurationError: they are no dictionary.
    """
    if values is not None and not isinstance(values, Mapping):
        raise ConfigurationError(f"settings of {owner} are a dictionary by field, not a {type(values).__name__}")
    return dict(values or {})


def check_kind(what: str, value: object, default: object) -> None:
    """Refuse what is not of the kind of a field's default; where that is no plain value, nothing is known.

    Args:
        what: field and owner, for the message.
        value: that is to be set.
        default: the field's. A whole number will do for a real one, but true and false are no numbers.

    Raises:
        ConfigurationError: it is of another kind, NaN or infinite, or beyond 32 bits.
    """
    if not isinstance(default, bool | int | float | str):
        return
    numeric = isinstance(default, float) and isinstance(value, int | float) and not isinstance(value, bool)
    if not numeric and type(value) is not type(default):
        kind = type(default).__name__
        raise ConfigurationError(f"{what} is {value!r}, but must be a {kind}, as its default {default!r}")
    if isinstance(value, int) and abs(value) > _LARGEST:
        raise ConfigurationError(f"{what} is {value}: give at most {_LARGEST}")
    if isinstance(value, float) and not math.isfinite(value):
        raise ConfigurationError(f"{what} is {value}: give a finite number")
