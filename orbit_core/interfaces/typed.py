"""Whether the fields of a dataclass hold what their annotations say, down to the last number of what lies within."""

from __future__ import annotations

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


class Typed:
    """Holds dataclasses, and the dataclasses within them, to their annotations.

    Args:
        rules: what some of them must keep besides.
    """

    def __init__(self, rules: Rules | None = None) -> None:
        self._rules = rules or {}

    def check(self, thing: object, where: str) -> None:
        """Check all fields; NaN is no number, lists and arrays are tuples, and a whole number is a real one.

        Args:
            thing: an instance of a dataclass.
            where: its name, for the message.

        Raises:
            ArgumentError: names the field, by its path from ``where``, its value and what is wanted.
        """
        for name, hint in _hints(type(thing)).items():
            self._value(getattr(thing, name), hint, f"{where}.{name}")
        rule = self._rules.get(type(thing))
        if rule is not None:
            rule(thing, where)

    def _value(self, value: Any, hint: Any, where: str) -> None:
        origin = typing.get_origin(hint)
        if origin in (typing.Union, types.UnionType):
            self._union(value, typing.get_args(hint), where)
        elif origin is tuple:
            self._tuple(value, typing.get_args(hint), where)
        elif origin is not None and isinstance(origin, type) and issubclass(origin, Mapping):
            self._mapping(value, typing.get_args(hint), where)
        elif origin is np.ndarray:
            _check_array(value, where)
        elif isinstance(hint, type):
            self._plain(value, hint, where)

    def _union(self, value: Any, branches: Sequence[Any], where: str) -> None:
        if value is None and type(None) in branches:
            return None
        kinds = [branch for branch in branches if isinstance(branch, type) and dataclasses.is_dataclass(branch)]
        for branch in kinds:
            if isinstance(value, branch):
                return self._value(value, branch, where)
        others = [branch for branch in branches if branch not in kinds and branch is not type(None)]
        if not others:
            raise wrong(where, value, " or ".join(kind.__name__ for kind in kinds))
        refusals: list[ArgumentError] = []
        for branch in others:
            try:
                return self._value(value, branch, where)
            except ArgumentError as refusal:
                refusals.append(refusal)
        raise refusals[0]

    def _tuple(self, value: Any, parts: Sequence[Any], where: str) -> None:
        if not isinstance(value, Sequence | np.ndarray) or isinstance(value, str | bytes):
            raise wrong(where, value, "a tuple")
        repeated = len(parts) == 2 and parts[1] is Ellipsis
        if not repeated and len(value) != len(parts):
            raise wrong(where, value, f"{len(parts)} of them")
        for index, part in enumerate(value):
            self._value(part, parts[0] if repeated else parts[index], f"{where}[{index}]")

    def _mapping(self, value: Any, parts: Sequence[Any], where: str) -> None:
        if not isinstance(value, Mapping):
            raise wrong(where, value, "a dictionary")
        for key, part in value.items():
            self._value(key, parts[0], f"a key of {where}")
            self._value(part, parts[1], f"{where}[{key!r}]")

    def _plain(self, value: Any, hint: type, where: str) -> None:
        if hint is float or hint is int:
            wanted = numbers.Real if hint is float else numbers.Integral
            if isinstance(value, bool | np.bool_) or not isinstance(value, wanted) or math.isnan(value):
                raise wrong(where, value, "a number" if hint is float else "a whole number")
        elif hint is bool:
            if not isinstance(value, bool | np.bool_):
                raise wrong(where, value, "true or false")
        elif (hint is str or issubclass(hint, Enum) or dataclasses.is_dataclass(hint)) and not isinstance(value, hint):
            raise wrong(where, value, f"a {hint.__name__}")
        elif dataclasses.is_dataclass(value):
            self.check(value, where)


@functools.cache
def _hints(kind: type) -> dict[str, Any]:
    hints = typing.get_type_hints(kind)
    return {field.name: hints[field.name] for field in dataclasses.fields(kind)}


def _check_array(value: Any, where: str) -> None:
    if not isinstance(value, np.ndarray) or not np.issubdtype(value.dtype, np.number):
        raise wrong(where, value, "an array of numbers")
    if np.isnan(value).any():
        raise ArgumentError(f"{where} holds NaN: give numbers")


def wrong(where: str, value: object, wanted: str) -> ArgumentError:
    """The error that a value at some place is not what is wanted there."""
    shown = repr(value)
    return ArgumentError(f"{where} is {shown if len(shown) < 80 else type(value).__name__}: give {wanted}")
