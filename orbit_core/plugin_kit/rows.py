"""How environments are picked out of arrays and tensors that have a row for each."""

from __future__ import annotations

from typing import TypeVar

import numpy as np
import numpy.typing as npt
from torch import Tensor

_Index = TypeVar("_Index", Tensor, npt.NDArray[np.int64])

Rows = Tensor | slice
"""Indices of environments, or all."""
HostRows = npt.NDArray[np.int64] | slice
"""The same, of NumPy's arrays."""


def rows_of(env_ids: Tensor | None) -> Rows:
    """The rows of these environments; all without any."""
    return slice(None) if env_ids is None else env_ids


def host_rows(env_ids: Tensor | None) -> HostRows:
    """As :func:`rows_of`, for arrays on the host; the environments are named there too."""
    return slice(None) if env_ids is None else env_ids.numpy()


def block(rows: _Index | slice, columns: _Index) -> tuple[_Index | slice, _Index]:
    """The index of ``columns`` (k,) in each of ``rows``."""
    return (rows, columns) if isinstance(rows, slice) else (rows[:, None], columns)
