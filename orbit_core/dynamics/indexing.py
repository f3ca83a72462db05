"""Choosing columns of state tensors cheaply, and writing rows by index or by mask."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import TypeGuard

import torch
from torch import Tensor

from orbit_core.interfaces import ConfigurationError

Columns = slice | Tensor
"""What ``tensor[:, columns]`` takes."""


def columns_of(indices: Sequence[int], device: torch.device) -> Columns:
    """Indices as a slice where they stand in a row, since a view costs less than a gather; else a tensor (k,)."""
    first = indices[0] if indices else 0
    if list(indices) == list(range(first, first + len(indices))):
        return slice(first, first + len(indices))
    return torch.tensor(list(indices), dtype=torch.int64, device=device)


def is_mask(env_ids: Tensor | None) -> TypeGuard[Tensor]:
    """Whether environments are given as (N,) bool, and not as int64 indices (n,)."""
    return env_ids is not None and env_ids.dtype == torch.bool


def write_rows(target: Tensor, values: Tensor | float, env_ids: Tensor | None) -> None:
    """Set the rows of some environments; with a mask ``values`` are of all, and those outside of it count for nothing.

    Nothing waits for the device.
    """
    if env_ids is None:
        target[:] = values
    elif env_ids.dtype != torch.bool:
        target[env_ids] = values
    else:
        mask = env_ids.view(-1, *(1 for _ in target.shape[1:]))
        target.copy_(torch.where(mask, values, target))


def write_block(target: Tensor, columns: Columns, values: Tensor, env_ids: Tensor | None) -> None:
    """As :func:`write_rows`, to some columns alone."""
    if is_mask(env_ids):
        values, env_ids = torch.where(env_ids[:, None], values, target[:, columns]), None
    if env_ids is None:
        target[:, columns] = values
    else:
        target[env_ids if isinstance(columns, slice) else env_ids[:, None], columns] = values


class Masking:
    """While a mask is set, what is written or drawn for all environments counts for those of the mask alone.

    So that code which takes indices runs without knowing how many there are: it is given all of them.
    """

    def __init__(self) -> None:
        self.mask: Tensor | None = None
        """(N,) bool"""

    @contextmanager
    def only(self, mask: Tensor) -> Iterator[None]:
        """Set a mask."""
        self.mask = mask
        try:
            yield
        finally:
            self.mask = None

    def rows(self, env_ids: Tensor | None) -> Tensor | None:
        """What a call for ``env_ids`` is meant for: they themselves, or the mask.

        Raises:
            ConfigurationError: the call is for a choice of its own, under a mask.
        """
        if self.mask is None:
            return env_ids
        if env_ids is not None and len(env_ids) != len(self.mask):
            raise ConfigurationError(
                f"{len(env_ids)} of {len(self.mask)} environments are written under a mask: give env_ids as they came"
            )
        return self.mask
