"""Looking things up by name and by regular expression, the same way everywhere."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence

from orbit_core.interfaces.errors import ConfigurationError, UnknownNameError


def find_name(name: str, names: Sequence[str], kind: str, where: str = "") -> int:
    """The index of ``name`` in ``names``.

    Raises:
        UnknownNameError: it is not there.
    """
    try:
        return names.index(name)
    except ValueError:
        raise UnknownNameError(kind, name, names, where) from None


def match_names(patterns: Sequence[str], names: Sequence[str], kind: str, where: str = "") -> list[int]:
    """Indices, ascending, of all names that one of the regular expressions matches in full.

    Raises:
        UnknownNameError: a pattern matches no name.
        ConfigurationError: a pattern is not a regular expression.
    """
    found: set[int] = set()
    for pattern in patterns:
        matches = _full_matches(pattern, names, kind)
        if not matches:
            raise UnknownNameError(kind, pattern, names, where)
        found.update(matches)
    return sorted(found)


def match_values(values: Mapping[str, float], names: Sequence[str], kind: str, where: str = "") -> dict[int, float]:
    """Index -> value for every name that a key matches in full; a later key overrides an earlier one.

    Raises:
        UnknownNameError: a key matches no name.
    """
    result: dict[int, float] = {}
    for pattern, value in values.items():
        result.update(dict.fromkeys(match_names((pattern,), names, kind, where), value))
    return result


def _full_matches(pattern: str, names: Sequence[str], kind: str) -> list[int]:
    if not isinstance(pattern, str):
        raise ConfigurationError(f"a {kind} pattern must be a string, not {pattern!r}: give several one by one")
    try:
        expression = re.compile(pattern)
    except re.error as error:
        raise ConfigurationError(f"{kind} pattern '{pattern}' is not a regular expression: {error}") from None
    return [index for index, name in enumerate(names) if expression.fullmatch(name)]
