"""Tensors and a document in one safetensors file; reading such a file never executes code that it contains.

The document is JSON in the header's metadata, under the key ``orbit``. A file is refused if it is larger than 1 GiB or
its header than 4 MiB, if its tensors do not fill exactly what the header says, or if one holds NaN or infinity.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NoReturn

import safetensors.torch
import torch
from safetensors import SafetensorError
from torch import Tensor

from orbit_core.files import MAX_FILE, as_path, read_bytes, written_whole
from orbit_core.interfaces import ConfigurationError, NonFiniteError

MAX_HEADER = 2**22
"""Limit of a header's bytes, including the document."""
_KEY = "orbit"


def read_tensors(path: Path | str) -> tuple[dict[str, Any], dict[str, Tensor]]:
    """Read the document and the tensors, on the CPU.

    Raises:
        ConfigurationError: the file does not exist, is malformed, or exceeds the limits.
        NonFiniteError: a tensor contains NaN or infinity; the message names it.
    """
    data = read_bytes(path, MAX_FILE)
    try:
        document = parse_json(_metadata(data)[_KEY])
        tensors = safetensors.torch.load(data)
    except KeyError as error:
        raise ConfigurationError(f"{path} lacks {error}: it was not written by ORBIT") from None
    except (ValueError, TypeError, SafetensorError) as error:
        raise ConfigurationError(f"{path} cannot be read: {_first_line(error)}") from None
    for name, tensor in tensors.items():
        if tensor.is_complex():
            raise ConfigurationError(f"{path} holds complex numbers in '{name}'")
        if tensor.is_floating_point() and not bool(torch.isfinite(tensor).all()):
            raise NonFiniteError(f"{path} holds NaN or infinity in '{name}'")
    return document, tensors


def write_tensors(path: Path | str, document: Mapping[str, Any], tensors: Mapping[str, Tensor]) -> None:
    """Write a file for :func:`read_tensors`; it appears complete or not at all.

    Args:
        path: path of the file, which is replaced.
        document: document, which JSON can represent.
        tensors: tensors by name, on any device.

    Raises:
        ConfigurationError: the file would exceed the limits of reading.
        StorageError: the disk is full, or the folder cannot be written.
    """
    path = as_path(path)
    text = json.dumps(document, allow_nan=False)
    # Copies, because the format refuses tensors that share memory.
    copies = {name: tensor.detach().cpu().clone().contiguous() for name, tensor in tensors.items()}
    data = safetensors.torch.save(copies, {_KEY: text})
    if len(data) > MAX_FILE or _header_size(data) > MAX_HEADER:
        raise ConfigurationError(f"{path} would be larger than what is read again: {len(data):,} bytes")
    with written_whole(path) as written:
        written.write_bytes(data)


def parse_json(text: str | bytes) -> dict[str, Any]:
    """Parse an object of JSON; NaN and infinity, which Python's parser would accept, are refused.

    Raises:
        ValueError: the text is not an object, or nested too deeply for Python.
    """
    try:
        values = json.loads(text, parse_constant=_refuse)
    except RecursionError:
        raise ValueError("its JSON is nested too deeply") from None
    if not isinstance(values, dict):
        raise ValueError(f"its JSON is no object but a {type(values).__name__}")
    return values


def _metadata(data: bytes) -> dict[str, Any]:
    size = _header_size(data)
    if size > min(MAX_HEADER, len(data) - 8):
        raise ValueError(f"its header says that it has {size:,} bytes, of {len(data):,} in the file")
    metadata = parse_json(data[8 : 8 + size])["__metadata__"]
    if not isinstance(metadata, dict):
        raise ValueError("its metadata is no object")
    return metadata


def _header_size(data: bytes) -> int:
    if len(data) < 8:
        raise ValueError(f"it has {len(data)} bytes, fewer than a header")
    return int.from_bytes(data[:8], "little")  # safetensors begins with the header's size in 8 bytes


def _refuse(constant: str) -> NoReturn:
    raise ValueError(f"its JSON holds {constant}")


def _first_line(error: Exception) -> str:
    return (str(error).splitlines() or [type(error).__name__])[0]
