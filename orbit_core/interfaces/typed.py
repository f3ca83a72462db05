"""Whether the fields of a dataclass hold what their annotations say, down to the last number of what lies within."""

from __future__ import annotations

import contextlib
import dataclasses
import functools
import math
import numbers
import types
import typing
from collections.abc import Callable, Mapping, Sequence
from enum import Enum
from typing import Any

import numpy as np

from orbit_core.interfaces.errors import ArgumentError

Rules = Mapping[type, Callable[[Any, str], None]]
"""What instances of a dataclass must keep besides their fields' types: raises an error that names the place given."""

Check = Callable[[Any, str], None]
"""Holds a value to a type, and names the place given where it is none of that type."""


class Typed:
    """Holds dataclasses, and the dataclasses within them, to their annotations.

    Args:
        rules: what some of them must keep besides.
    """

    def __init__(self, rules: Rules | None = None) -> None:
        self._rules = rules or {}
        self._checks: dict[Any, Check] = {}
        self._fields: dict[type, list[tuple[str, Check]]] = {}

    def check(self, thing: object, where: str) -> None:
        """Check all fields; NaN is no number, lists and arrays are tuples, and a whole number is a real one.

        Args:
            thing: an instance of a dataclass.
            where: its name, for the message.

        Raises:
            ArgumentError: names the field, by its path from ``where``, its value and what is wanted.
        """
        with contextlib.suppress(ArgumentError):
            # Most things are sound, and writing their paths would take longer than all that is checked.
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
            fields = self._fields[kind] = [(name, self._of(hint)) for name, hint in _hints(kind).items()]
        for name, check in fields:
            check(getattr(thing, name), where and f"{where}.{name}")
        rule = self._rules.get(kind)
        if rule is not None:
            rule(thing, where)

    def _of(self, hint: Any) -> Check:
        """The check of a type, made once."""
        if hint not in self._checks:
            self._checks[hint] = self._made(hint)
        return self._checks[hint]

    def _made(self, hint: Any) -> Check:
        origin, arguments = typing.get_origin(hint), typing.get_args(hint)
        if origin in (typing.Union, types.UnionType):
            return self._union(arguments)
        if origin is tuple:
            return self._tuple(arguments)
        if origin is not None and isinstance(origin, type) and issubclass(origin, Mapping):
            return self._mapping(*arguments)
        if origin is np.ndarray:
            return _check_array
        return self._plain(hint) if isinstance(hint, type) else _check_nothing

    def _union(self, branches: Sequence[Any]) -> Check:
        kinds = tuple(branch for branch in branches if isinstance(branch, type) and dataclasses.is_dataclass(branch))
        others = [self._of(each) for each in branches if each not in kinds and each is not type(None)]
        optional = type(None) in branches

        def check(value: Any, where: str) -> None:
            if value is None and optional:
                return None
            if isinstance(value, kinds):
                self._dataclass(value, where)
                return None
            if not others:
                raise wrong(where, value, " or ".join(kind.__name__ for kind in kinds))
            refusals: list[ArgumentError] = []
            for other in others:
                try:
                    return other(value, where)
                except ArgumentError as refusal:
                    refusals.append(refusal)
            raise refusals[0]

        return check

    def _tuple(self, parts: Sequence[Any]) -> Check:
        repeated = len(parts) == 2 and parts[1] is Ellipsis
        checks = [self._of(part) for part in parts if part is not Ellipsis]

        def check(value: Any, where: str) -> None:
            if not isinstance(value, tuple | Sequence | np.ndarray) or isinstance(value, str | bytes):
                raise wrong(where, value, "a tuple")
            if not repeated and len(value) != len(checks):
                raise wrong(where, value, f"{len(checks)} of them")
            for index, part in enumerate(value):
                checks[0 if repeated else index](part, where and f"{where}[{_key(part, index)}]")

        return check

    def _mapping(self, key_hint: Any, part_hint: Any) -> Check:
        check_key, check_part = self._of(key_hint), self._of(part_hint)

        def check(value: Any, where: str) -> None:
            if not isinstance(value, Mapping):
                raise wrong(where, value, "a dictionary")
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
                raise wrong(where, value, f"a {hint.__name__}")
            if not isinstance(value, type) and dataclasses.is_dataclass(value):
                self._dataclass(value, where)

        return check


def _key(part: Any, index: int) -> str:
    """What a part is found by: its name, where it has one, says more than its place."""
    name = getattr(part, "name", "")
    return repr(name) if isinstance(name, str) and name and dataclasses.is_dataclass(part) else str(index)


@functools.cache
def _hints(kind: type) -> dict[str, Any]:
    hints = typing.get_type_hints(kind)
    return {field.name: hints[field.name] for field in dataclasses.fields(kind)}


def _check_nothing(value: Any, where: str) -> None:
    """Check nothing, for types that say nothing about values."""


def _check_number(value: Any, where: str) -> None:
    if type(value) is float and value == value:
        return
    if isinstance(value, bool | np.bool_) or not isinstance(value, numbers.Real) or math.isnan(value):
        raise wrong(where, value, "a number")


def _check_whole_number(value: Any, where: str) -> None:
    if isinstance(value, bool | np.bool_) or not isinstance(value, numbers.Integral):
        raise wrong(where, value, "a whole number")


def _check_truth(value: Any, where: str) -> None:
    if not isinstance(value, bool | np.bool_):
        raise wrong(where, value, "true or false")


def _check_array(value: Any, where: str) -> None:
    if not isinstance(value, np.ndarray) or value.dtype.kind not in "fiu":
        raise wrong(where, value, "an array of real numbers")
    if np.isnan(value).any():
        raise ArgumentError(f"{where} holds NaN: give numbers")


def wrong(where: str, value: object, wanted: str) -> ArgumentError:
    """The error that a value at some place is not what is wanted there."""
    shown = repr(value)
    return ArgumentError(f"{where} is {shown if len(shown) < 80 else type(value).__name__}: give {wanted}")
