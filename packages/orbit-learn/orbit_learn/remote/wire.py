"""Messages of OpenPI's protocol: MessagePack with NumPy arrays in it, read strictly.

An array is a map ``{b"__ndarray__": True, b"data": bytes, b"dtype": "<f4", b"shape": [..]}``, a scalar of NumPy's a map
``{b"__npgeneric__": True, b"data": number, b"dtype": ..}``. The published decoder builds arrays of any dtype that was
sent, of objects too, whose bytes are then taken for pointers; this one takes numbers of the right length alone.
"""

from __future__ import annotations

import math
from typing import Any

import msgspec
import numpy as np

from orbit_core.interfaces import ConfigurationError

MOST_BYTES = 1 << 26
"""Of a message: sixteen pictures of a megapixel."""
_MOST_DEPTH = 16
# Values in all maps and lists of a message, whose every byte may be an empty map that takes 64 in memory. A message of
# at most so many bytes cannot hold more.
_MOST_VALUES = 1 << 16
_KINDS = "biuf"


def encode(value: Any) -> bytes:
    """Return a message of dictionaries, lists, texts, numbers and arrays."""
    return msgspec.msgpack.encode(_packed(value))


def decode(data: bytes) -> dict[str, Any]:
    """Return the map that a message holds, its arrays read-only.

    Raises:
        ConfigurationError: it is no map, or holds an array that is none, is of other than numbers, or is not finite.
    """
    try:
        if len(data) > _MOST_VALUES:
            _count_values(msgspec.Raw(data))
        message = _unpacked(msgspec.msgpack.decode(data), 0)
    # The decoder skips and builds nested values by recursion, and reports texts that are no UTF-8 as Python does.
    except (msgspec.DecodeError, RecursionError, UnicodeDecodeError) as error:
        raise ConfigurationError(f"it is no MessagePack: {error}") from None
    if not isinstance(message, dict) or not all(isinstance(key, str) for key in message):
        raise ConfigurationError("it is no map with texts as keys")
    return message


def _packed(value: Any) -> Any:
    if isinstance(value, np.ndarray):
        # The shape is taken from the value, because contiguous copies of scalars have one dimension.
        array = np.ascontiguousarray(value)
        shape = list(value.shape)
        return {b"__ndarray__": True, b"data": array.tobytes(), b"dtype": array.dtype.str, b"shape": shape}
    if isinstance(value, np.generic):
        return value.item()
    if isinstance(value, dict):
        return {key: _packed(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_packed(item) for item in value]
    return value


# First byte of short maps and lists, which hold their number of entries in four bits, and the first byte of those whose
# number follows in two bytes; after the next higher byte it follows in four. A map has two values for each entry.
_HEADS = ((0x80, 0xDE, 2), (0x90, 0xDC, 1))


def _count_values(raw: msgspec.Raw, depth: int = 0) -> int:
    """Return the number of values in all maps and lists of a message, none of which is built.

    Raises:
        ConfigurationError: there are too many, or they are nested too deep.
    """
    data = memoryview(raw)
    first = data[0] if data else 0
    for short, long, values in _HEADS:
        if first & 0xF0 != short and first not in (long, long + 1):
            continue
        size = 0 if first & 0xF0 == short else 2 if first == long else 4
        count = values * (int.from_bytes(data[1 : 1 + size], "big") if size else first & 0x0F)
        if depth <= _MOST_DEPTH and count <= _MOST_VALUES:
            # A map too is read as a list, of its keys and values in turn.
            listed = b"\xdd" + count.to_bytes(4, "big") + data[1 + size :]
            parts = msgspec.msgpack.decode(listed, type=list[msgspec.Raw])
            count += sum(_count_values(part, depth + 1) for part in parts)
        if depth > _MOST_DEPTH or count > _MOST_VALUES:
            raise ConfigurationError(
                f"it holds more than {_MOST_VALUES:,} values, or is nested more than {_MOST_DEPTH} deep: send arrays "
                "in place of lists"
            )
        return count
    return 0


def _unpacked(value: Any, depth: int) -> Any:
    # Deep nesting would end in a RecursionError, which is not caught as a fault of the message.
    if depth > _MOST_DEPTH:
        raise ConfigurationError(f"it is nested more than {_MOST_DEPTH} deep")
    if isinstance(value, dict):
        # Both forms are in use: some clients pack keys as texts.
        if b"__ndarray__" in value or "__ndarray__" in value:
            return _array({_text(key): item for key, item in value.items()})
        if b"__npgeneric__" in value or "__npgeneric__" in value:
            return _number({_text(key): item for key, item in value.items()}.get("data"))
        return {_text(key): _unpacked(item, depth + 1) for key, item in value.items()}
    if isinstance(value, list):
        return [_unpacked(item, depth + 1) for item in value]
    return _number(value) if isinstance(value, float) else value


def _text(key: Any) -> Any:
    return key.decode("utf-8", "replace") if isinstance(key, bytes) else key


def _number(value: Any) -> Any:
    if isinstance(value, float) and not math.isfinite(value):
        raise ConfigurationError("it holds a number that is not finite")
    if not isinstance(value, bool | int | float):
        raise ConfigurationError("it holds a scalar that is no number")
    return value


def _array(told: dict[str, Any]) -> np.ndarray:
    data, name, shape = told.get("data"), told.get("dtype"), told.get("shape")
    if not (isinstance(data, bytes) and isinstance(name, str | bytes) and isinstance(shape, list)):
        raise ConfigurationError("it holds an array without data, dtype or shape")
    try:
        dtype = np.dtype(_text(name))
    except (TypeError, ValueError, SyntaxError):
        raise ConfigurationError(f"it holds an array of dtype {_text(name)[:20]!r}, which there is not") from None
    if dtype.kind not in _KINDS or dtype.subdtype is not None or dtype.itemsize > 8:
        raise ConfigurationError(f"it holds an array of {str(dtype)[:20]}: arrays hold numbers of up to 8 bytes")
    if not all(type(extent) is int and 0 <= extent <= MOST_BYTES for extent in shape) or len(shape) > 8:
        raise ConfigurationError("it holds an array whose shape is none")
    if math.prod(shape) * dtype.itemsize != len(data):
        raise ConfigurationError(f"it holds an array of shape {tuple(shape)} and {len(data)} bytes of {dtype}")
    try:
        array = np.frombuffer(data, dtype).reshape(shape)
    except ValueError:
        # An empty array may have extents whose product is beyond any size.
        raise ConfigurationError("it holds an array whose shape is none") from None
    if dtype.kind == "f" and not np.isfinite(array).all():
        raise ConfigurationError("it holds an array with NaN or infinity")
    return array
