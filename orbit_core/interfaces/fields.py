"""Settings as programs give them."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from orbit_core.interfaces.errors import ConfigurationError


def settings_table(values: Mapping[str, Any] | None, owner: str) -> dict[str, Any]:
    """Settings by field, none for None.

    Raises:
        ConfigurationError: they are no dictionary.
    """
    if values is not None and not isinstance(values, Mapping):
        raise ConfigurationError(f"settings of {owner} are a dictionary by field, not a {type(values).__name__}")
    return dict(values or {})
