"""Row selection for per-environment arrays and tensors."""

from __future__ import annotations

from typing import TypeGuard, TypeVar

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor

_Index = TypeVar("_Index", Tensor, npt.NDArray[np.int64])

Rows = Tensor | slice
"""Indices of environments, or all."""
HostRows = npt.NDArray[np.int64] | slice
"""The same, of NumPy's arrays."""


def rows_of(env_ids: Tensor | None) -> Rows:
    """Return the rows of these environments; all without any."""
    return slice(None) if env_ids is None else env_ids


def host_rows(env_ids: Tensor | None) -> HostRows:
    """Return the rows of these environments for arrays on the host, where ``env_ids`` must be too."""
    return slice(None) if env_ids is None else env_ids.numpy()


def block(rows: _Index | slice, columns: _Index) -> tuple[_Index | slice, _Index]:
    """Return the index of ``columns`` (k,) in each of ``rows``."""
    # Two index arrays broadcast against each other, which needs one more dimension on the rows.
    return (rows, columns) if isinstance(rows, slice) else (rows[:, None], columns)


def is_mask(env_ids: Tensor | None) -> TypeGuard[Tensor]:
    """Return True if environments are given as a mask (N,) bool, and not as indices (n,)."""
    return env_ids is not None and env_ids.dtype == torch.bool


def take_rows(values: Tensor, env_ids: Tensor | None) -> Tensor:
    """Return the rows of environments that are given by index; all rows for a mask or None."""
    return values if env_ids is None or is_mask(env_ids) else values[env_ids]


def write_rows(target: Tensor, values: Tensor | float, env_ids: Tensor | None) -> None:
    """Set the rows of some environments; with a mask ``values`` are of all, and those outside of it count for nothing.

    Nothing waits for the device.
    """
    if env_ids is None:
        target[:] = values
    # Indexing by a mask would wait for the device to count its rows; where does not.
    elif env_ids.dtype != torch.bool:
        target[env_ids] = values
    else:
        mask = env_ids.view(-1, *(1 for _ in target.shape[1:]))
        target.copy_(torch.where(mask, values, target))


def write_columns(target: Tensor, columns: Tensor, values: Tensor, env_ids: Tensor | None) -> None:
    """Set (N, k, ...) columns (k,) of some environments in ``target`` (N, K, ...), as :func:`write_rows` sets rows."""
    if is_mask(env_ids):
        mask = env_ids.view(-1, *(1 for _ in target.shape[1:]))
        values, env_ids = torch.where(mask, values, target[:, columns]), None
    if env_ids is None:
        target[:, columns] = values
    else:
        target[env_ids[:, None], columns] = values
