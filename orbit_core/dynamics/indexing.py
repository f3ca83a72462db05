"""Choosing columns of state tensors cheaply."""

from __future__ import annotations

from collections.abc import Sequence

import torch
from torch import Tensor

Columns = slice | Tensor
"""What ``tensor[:, columns]`` takes."""


def columns_of(indices: Sequence[int], device: torch.device) -> Columns:
    """Indices as a slice where they stand in a row, since a view costs less than a gather; else a tensor (k,)."""
    first = indices[0] if indices else 0
    if list(indices) == list(range(first, first + len(indices))):
        return slice(first, first + len(indices))
    return torch.tensor(list(indices), dtype=torch.int64, device=device)
