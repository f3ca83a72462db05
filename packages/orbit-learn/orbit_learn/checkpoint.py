"""All that a training goes on with, as one file of data: no pickle, whatever the learning library writes by itself.

A state is a tree of dictionaries, lists, numbers, texts, truth values, None and tensors; libraries keep theirs so in
``state_dict``. Tuples become lists, and NumPy's arrays and numbers become tensors and numbers. In the file, see
:mod:`orbit_data.tensor_file`, a dictionary is ``{"items": [[key, value], ...]}``, for its keys may be numbers,
and a tensor ``{"tensor": name}``.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor

from orbit_core.interfaces import ConfigurationError
from orbit_data.tensor_file import read_tensors, write_tensors

FORMAT = 1


def write_checkpoint(path: Path | str, library: str, state: Any) -> None:
    """Write a library's state. The file appears whole or not at all.

    Raises:
        ConfigurationError: the state holds something that is no data; names it.
    """
    tensors: dict[str, Tensor] = {}
    document = {"checkpoint": FORMAT, "library": library, "state": _packed(state, tensors)}
    write_tensors(path, document, tensors)


def tensors_in(state: Any) -> list[Tensor]:
    """Return all tensors of a library's state.

    Raises:
        ConfigurationError: the state holds something that is no data; names it.
    """
    tensors: dict[str, Tensor] = {}
    _packed(state, tensors)
    return list(tensors.values())


def read_checkpoint(path: Path | str, library: str) -> Any:
    """The state that :func:`write_checkpoint` wrote, its tensors on the CPU.

    Raises:
        ConfigurationError: the file is malformed, no checkpoint, or of another library.
    """
    document, tensors = read_tensors(path)
    if document.get("checkpoint") != FORMAT:
        raise ConfigurationError(f"{path} is no checkpoint of format {FORMAT}, the one that is read")
    if document.get("library") != library:
        raise ConfigurationError(f"{path} is a checkpoint of library {document.get('library')!r}, not of '{library}'")
    try:
        return _unpacked(document.get("state"), tensors)
    except (KeyError, TypeError, ValueError, RecursionError) as error:
        raise ConfigurationError(f"{path} holds no state: {type(error).__name__} {error}") from None


def _packed(value: Any, tensors: dict[str, Tensor]) -> Any:
    if isinstance(value, np.generic):
        value = value.item()
    if isinstance(value, np.ndarray):
        value = torch.from_numpy(value)
    if isinstance(value, Tensor):
        name = str(len(tensors))
        tensors[name] = value
        return {"tensor": name}
    if isinstance(value, dict):
        return {"items": [[_packed(key, tensors), _packed(item, tensors)] for key, item in value.items()]}
    if isinstance(value, list | tuple):
        return [_packed(item, tensors) for item in value]
    if value is None or isinstance(value, bool | int | float | str):
        return value
    raise ConfigurationError(f"a checkpoint holds data, and no {type(value).__name__}")


def _unpacked(value: Any, tensors: dict[str, Tensor]) -> Any:
    if isinstance(value, list):
        return [_unpacked(item, tensors) for item in value]
    if isinstance(value, dict):
        if "tensor" in value:
            return tensors[value["tensor"]]
        return {key: _unpacked(item, tensors) for key, item in value["items"]}
    return value
