"""Look-up of things by name and by regular expression."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from typing import NoReturn, TypeVar

from orbit_core.interfaces.errors import ConfigurationError, UnknownNameError

_Thing = TypeVar("_Thing")


class NamedThings(dict[str, _Thing]):
    """Read-only dictionary of things by name; an unknown name raises an UnknownNameError with the nearest.

    It is a dictionary because tasks look up their robots several times a step.

    Args:
        things: by name.
        kind: of thing, in the singular.
        where: the attribute that holds them.
        siblings: collections of the same owner; a name that one lacks is looked up in the others for the message.
    """

    def __init__(self, things: Mapping[str, _Thing], kind: str, where: str, siblings: list[NamedThings]) -> None:
        super().__init__(things)
        self.kind = kind
        self.where = where
        self._siblings = siblings
        siblings.append(self)

    def __missing__(self, name: str) -> NoReturn:
        # The commonest mistake is an object looked up among robots, or the other way round.
        for other in self._siblings:
            if isinstance(name, str) and name in other:
                article = "an" if other.kind[0] in "aeiou" else "a"
                note = f"'{name}' is {article} {other.kind}: {other.where}['{name}']"
                raise UnknownNameError(self.kind, name, self, self.where, note)
        raise UnknownNameError(self.kind, name, self, self.where)

    def _read_only(self, *_: object, **__: object) -> NoReturn:
        raise ConfigurationError(f"{self.where} is read only: what a world holds is its scene's")

    __setitem__ = __delitem__ = __ior__ = _read_only  # pyright: ignore[reportAssignmentType, reportIncompatibleMethodOverride]
    clear = pop = popitem = setdefault = update = _read_only  # pyright: ignore[reportAssignmentType, reportIncompatibleMethodOverride]


def find_name(name: str, names: Sequence[str], kind: str, where: str = "") -> int:
    """Return the index of ``name`` in ``names``.

    Raises:
        UnknownNameError: it is not there.
    """
    try:
        return names.index(name)
    except ValueError:
        raise UnknownNameError(kind, name, names, where) from None


def match_names(patterns: Sequence[str], names: Sequence[str], kind: str, where: str = "") -> list[int]:
    """Return indices, ascending, of all names that one of the regular expressions matches in full.

    Raises:
        UnknownNameError: a pattern matches no name.
        ConfigurationError: a pattern is not a regular expression.
    """
    # A set, since several patterns may match the same name; the order is that of the names.
    found: set[int] = set()
    for pattern in patterns:
        matches = _full_matches(pattern, names, kind)
        if not matches:
            raise UnknownNameError(kind, pattern, names, where)
        found.update(matches)
    return sorted(found)


def match_values(values: Mapping[str, float], names: Sequence[str], kind: str, where: str = "") -> dict[int, float]:
    """Return index -> value for every name that a key matches in full; a later key overrides an earlier one.

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
        # Compiled here for its error: fullmatch would report it without the pattern.
        expression = re.compile(pattern)
    except re.error as error:
        raise ConfigurationError(f"{kind} pattern '{pattern}' is not a regular expression: {error}") from None
    return [index for index, name in enumerate(names) if expression.fullmatch(name)]
