"""Any configuration as plain data for JSON: dataclasses, functions with what they have bound, arrays by digest."""

from __future__ import annotations

import dataclasses
import functools
import hashlib
import inspect
import json
import math
from collections.abc import Mapping
from enum import Enum
from pathlib import Path
from typing import Any

import numpy as np
from torch import Tensor

_LISTED = 64
"""Most numbers of an array that are written out; of more, the digest stands."""
_DIGITS = 16
"""Hexadecimal digits of a digest, 64 bits of SHA-256."""


def as_plain(value: Any) -> Any:
    """A value as JSON can hold it, the same on every machine and in every process.

    A dataclass becomes an object of its fields, with its ``type``; a function its module and name, with the values that
    it has bound. What is none of these is told by its type alone.
    """
    if value is None or isinstance(value, bool | int | str):
        return value
    if isinstance(value, float | np.generic):
        return _number(value)
    if isinstance(value, Enum):
        return as_plain(value.value)
    if isinstance(value, Path):
        return str(value)
    if isinstance(value, Tensor | np.ndarray):
        return _array(value.detach().cpu().numpy() if isinstance(value, Tensor) else value)
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        own = {field.name: as_plain(getattr(value, field.name)) for field in dataclasses.fields(value) if field.init}
        return {"type": _name(type(value)), **own}
    if isinstance(value, Mapping):
        return {str(key): as_plain(item) for key, item in value.items()}
    if isinstance(value, set | frozenset):
        return sorted((as_plain(item) for item in value), key=str)
    if isinstance(value, list | tuple):
        return [as_plain(item) for item in value]
    return _function(value) if callable(value) else {"type": _name(type(value))}


def digest(value: Any) -> str:
    """16 hexadecimal digits that differ where plain data differs in anything, the numbers of arrays included."""
    text = json.dumps(as_plain(value), sort_keys=True)
    return hashlib.sha256(text.encode()).hexdigest()[:_DIGITS]


def _number(value: Any) -> Any:
    number = value.item() if isinstance(value, np.generic) else value
    return number if not isinstance(number, float) or math.isfinite(number) else str(number)


def _array(array: np.ndarray[Any, Any]) -> Any:
    if array.size <= _LISTED and array.dtype.kind in "fiub":
        return as_plain(array.tolist())
    content = hashlib.sha256(np.ascontiguousarray(array).tobytes()).hexdigest()[:_DIGITS]
    return {"shape": list(array.shape), "dtype": str(array.dtype), "digest": content}


def _function(value: Any) -> Any:
    if isinstance(value, functools.partial):
        return {"function": as_plain(value.func), "bound": as_plain([value.args, value.keywords])}
    value = inspect.unwrap(value)  # a cache around a function is not what it computes
    bound = inspect.getclosurevars(value).nonlocals if inspect.isfunction(value) else {}
    return {"function": _name(value), "bound": as_plain(bound)} if bound else _name(value)


def _name(value: Any) -> str:
    return f"{value.__module__}.{value.__qualname__}" if hasattr(value, "__qualname__") else _name(type(value))
