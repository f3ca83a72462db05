"""How environments are picked out of tensors that have a row for each."""

# pyright: reportArgumentType=false
# Warp's arrays carry their types at run time.

from __future__ import annotations

import warp as wp
from torch import Tensor

Rows = Tensor | slice
"""Indices of environments, or all."""


def rows_of(env_ids: Tensor | None) -> Rows:
    """The rows of these environments; all without any."""
    return slice(None) if env_ids is None else env_ids


def block(rows: Rows, columns: Tensor) -> tuple[Rows, Tensor]:
    """The index of ``columns`` (k,) in each of ``rows``."""
    return (rows, columns) if isinstance(rows, slice) else (rows[:, None], columns)


def array_of(values: Tensor | None, otherwise: wp.array) -> wp.array:
    """``values`` as a kernel takes them, or what stands for none."""
    return otherwise if values is None else wp.from_torch(values.contiguous())
