"""Configurations as plain data for JSON: dataclasses, functions with their bound values, arrays by digest."""

from __future__ import annotations

import dataclasses
import functools
import hashlib
import inspect
import json
import math
from collections.abc import Callable, Mapping
from enum import Enum
from pathlib import Path
from typing import Any

import numpy as np
from torch import Tensor

from orbit_core.scene import Finish

# Limit of the numbers of an array that are written out; larger arrays become digests.
_LISTED = 64
# Hexadecimal digits of a digest, 64 bits of SHA-256.
_DIGITS = 16
ROUNDED = "~"
"""What a digest begins with whose numbers are rounded; those of before were of every bit."""
# Types that have moved, by the names that digests have known them by since before: a robot of a dataset or policy that
# was recorded then is the same robot, whatever module describes its joints now.
_FIRST_NAMES = {
    f"orbit_core.scene.{module}.{name}": f"orbit_core.scene.{first}.{name}"
    for module, first, names in (
        ("articulation", "joints", ("DriveGains", "Joint", "LoopJoint", "Mimic")),
        ("actuators", "motors", ("Transmission", "Windings")),
        ("shapes", "materials", ("Compliance", "PhysicsMaterial")),
        ("shapes", "textures", ("Texture",)),
        ("entities", "active", ("ActiveModel", "MagneticSeal")),
        ("scene", "lights", ("AmbientLight", "DirectionalLight", "Sky")),
        ("scene", "markers", ("MarkerSpec",)),
    )
    for name in names
}
# Significant digits of numbers in a digest: processors and versions of Python differ in the last bits.
_KEPT = 9
# Limit below which numbers are zero in a digest, because they are remainders of cancellation.
_NOTHING = 1e-12


def as_plain(value: Any, for_digest: bool = False) -> Any:
    """Convert a value to data for JSON, the same on every machine and in every process.

    A dataclass becomes an object of its fields, with its ``type``; a function its module and name, with its bound
    values. Values of other types become only the name of their type.

    Args:
        value: value of any type.
        for_digest: round numbers to nine significant digits (of an array's largest number), and leave out fields that
            are None or a surface's finish, so that a field that is added later changes no digest of data that does not
            use it.
    """
    plain = functools.partial(as_plain, for_digest=for_digest)
    if value is None or isinstance(value, bool | int | str):  # of numbers only those without rounding
        return value
    if isinstance(value, float | np.generic):
        return _number(value, for_digest)
    if isinstance(value, Enum):
        return plain(value.value)
    if isinstance(value, Path):
        return str(value)
    if isinstance(value, Tensor | np.ndarray):
        array = value.detach().cpu().numpy() if isinstance(value, Tensor) else value
        return _array(_rounded(array) if for_digest and array.dtype.kind == "f" else array)
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        own = {field.name: getattr(value, field.name) for field in dataclasses.fields(value) if field.init}
        told = {name: plain(each) for name, each in own.items() if not (for_digest and _is_unused(each))}
        name = _name(type(value))
        return {"type": _FIRST_NAMES.get(name, name) if for_digest else name, **told}
    if isinstance(value, Mapping):
        return {str(key): plain(item) for key, item in value.items()}
    if isinstance(value, set | frozenset):  # sorted, because its order depends on the process
        return sorted((plain(item) for item in value), key=str)
    if isinstance(value, list | tuple):
        return [plain(item) for item in value]
    return _function(value, plain) if callable(value) else {"type": _name(type(value))}


def digest(value: Any) -> str:
    """Compute a digest, ``~`` and 16 hexadecimal digits, of plain data, including the numbers of arrays.

    Differences beyond nine significant digits, and fields that are None, do not change it: the same computation on
    another machine has the same digest, and so has data from before an unused field was added.
    """
    text = json.dumps(as_plain(value, for_digest=True), sort_keys=True)
    return ROUNDED + hashlib.sha256(text.encode()).hexdigest()[:_DIGITS]


def _is_unused(value: Any) -> bool:
    """Return True for what a digest leaves out: None, and finishes, whose pictures decoders read in different ways."""
    return value is None or isinstance(value, Finish)


def _number(value: Any, rounded: bool) -> Any:
    number = value.item() if isinstance(value, np.generic) else value
    if not isinstance(number, float):
        return number
    if not math.isfinite(number):
        return str(number)
    if rounded:
        return 0.0 if abs(number) < _NOTHING else float(f"{number:.{_KEPT}g}")
    return number


def _rounded(array: np.ndarray[Any, Any]) -> np.ndarray[Any, Any]:
    """Round to multiples of one power of ten, so that the largest number keeps its significant digits."""
    values = np.asarray(array, np.float64)
    largest = float(np.abs(values[np.isfinite(values)]).max(initial=0.0))
    if largest < _NOTHING:
        return np.where(np.isfinite(values), 0.0, values)
    places = _KEPT - 1 - math.floor(math.log10(largest * (1.0 + 10.0**-_KEPT)))  # the same just below a power of ten
    return np.round(values, places) + 0.0  # and no zero with a sign


def _array(array: np.ndarray[Any, Any]) -> Any:
    if array.size <= _LISTED and array.dtype.kind in "fiub":
        return as_plain(array.tolist())
    content = hashlib.sha256(np.ascontiguousarray(array).tobytes()).hexdigest()[:_DIGITS]
    return {"shape": list(array.shape), "dtype": str(array.dtype), "digest": content}


def _function(value: Any, plain: Callable[[Any], Any]) -> Any:
    if isinstance(value, functools.partial):
        return {"function": plain(value.func), "bound": plain([value.args, value.keywords])}
    value = inspect.unwrap(value)  # a cache around a function does not change its results
    bound = inspect.getclosurevars(value).nonlocals if inspect.isfunction(value) else {}
    return {"function": _name(value), "bound": plain(bound)} if bound else _name(value)


def _name(value: Any) -> str:
    return f"{value.__module__}.{value.__qualname__}" if hasattr(value, "__qualname__") else _name(type(value))
