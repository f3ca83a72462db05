"""Choosing columns of state tensors cheaply, and writing rows by index or by mask."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass

import torch
from torch import Tensor

from orbit_core.dynamics.arguments import (
    POSITIONS,
    Bounds,
    as_floats,
    check_index_tensor,
    check_index_values,
    check_indices,
    check_numbers,
    check_quaternions,
    check_shape,
)
from orbit_core.interfaces import ArgumentError, ConfigurationError
from orbit_core.plugin_kit.rows import is_mask, take_rows, write_columns, write_rows

__all__ = [
    "Choice", "Columns", "Masking", "columns_of", "is_mask", "take_rows", "write_block", "write_columns", "write_rows",
]  # fmt: skip

Columns = slice | Tensor
"""What ``tensor[:, columns]`` takes."""


def columns_of(indices: Sequence[int], device: torch.device) -> Columns:
    """Return indices as a slice if they are consecutive, since a view costs less than a gather; else a tensor (k,)."""
    first = indices[0] if indices else 0
    if list(indices) == list(range(first, first + len(indices))):
        return slice(first, first + len(indices))
    return torch.tensor(list(indices), dtype=torch.int64, device=device)


def write_block(target: Tensor, columns: Columns, values: Tensor, env_ids: Tensor | None) -> None:
    """Write rows as :func:`write_rows` does, in some columns only."""
    if is_mask(env_ids):
        values, env_ids = torch.where(env_ids[:, None], values, target[:, columns]), None
    if env_ids is None:
        target[:, columns] = values
    else:
        # Indices of rows and of columns broadcast against each other only with one more dimension.
        target[env_ids if isinstance(columns, slice) else env_ids[:, None], columns] = values


@dataclass(slots=True)
class Choice:
    """Environments that a call is for, and checks of the values that come with it."""

    rows: Tensor | None
    """Indices (n,), a mask (N,) bool within a traced step, None for all: what an engine is given."""
    count: int
    """Rows that are given of each value."""
    device: torch.device
    taken: bool = False
    """True if values have N rows and must be indexed by ``rows``."""
    seen: bool = True
    """True if values of tensors may be checked."""

    def values(self, value: Tensor, shape: tuple[int, ...], what: str, bounds: Bounds) -> Tensor:
        """Return numbers (n, *shape) as an engine takes them: float32, on the device, without gradient.

        Raises:
            ArgumentError: another type, dtype or device, or out of bounds.
            ShapeError: another shape.
            NonFiniteError: NaN or infinite.
        """
        value = as_floats(value, self.device, what)
        check_shape(value, (self.count, *shape), what)
        if self.taken:
            value = value[self.rows]
        if self.seen:
            check_numbers(value, bounds, what, self.rows)
        return value

    def indices(self, value: Tensor, shape: tuple[int, ...], what: str, least: int, most: int) -> Tensor:
        """Return indices (n, *shape) int64 from ``least`` to ``most``, on the device.

        Raises:
            ArgumentError: another type or device, or out of bounds.
            ShapeError: another shape.
        """
        check_index_values(value, self.device, what)
        check_shape(value, (self.count, *shape), what)
        if self.taken:
            value = value[self.rows]
        if self.seen and not bool(((value >= least) & (value <= most)).all()):
            raise ArgumentError(f"{what} are indices from {least} to {most}, not {value.flatten().tolist()[:8]}")
        return value

    def poses(self, pose: Tensor, what: str) -> Tensor:
        """Return poses (n, 7); errors as of :meth:`values`, and for quaternions that are not of length 1."""
        pose = self.values(pose, (7,), what, POSITIONS)
        if self.seen:
            check_quaternions(pose, what, self.rows)
        return pose


class Masking:
    """Checked selection of the environments that a call is for; while a mask is set, only those of the mask.

    Under a mask, what is written or drawn for all environments counts for those of the mask: code which takes indices
    runs without knowing how many there are, for it is given all of them.
    """

    def __init__(self, num_envs: int, device: torch.device) -> None:
        self.mask: Tensor | None = None
        """(N,) bool"""
        self.traced = False
        """True while a step is traced: no code may read the values of tensors then."""
        self._num_envs = num_envs
        self._device = device
        # Indices that were found good, and their version, for one choice goes through many calls
        self._known: tuple[Tensor, int] | None = None

    @contextmanager
    def only(self, mask: Tensor | None) -> Iterator[None]:
        """Set a mask, in the place of one that is set; None lifts it."""
        # Masks nest: an event under a mask may reset a part of its environments.
        before, self.mask = self.mask, mask
        try:
            yield
        finally:
            self.mask = before

    def choose(self, env_ids: Tensor | None) -> Choice:
        """Return the selection for ``env_ids``, or for the mask that is set.

        A mask that a caller gives comes with values of all environments; outside of a traced step it is converted to
        indices.

        Raises:
            ArgumentError: no environments: of another type, dtype or device, out of range, or one twice.
            ShapeError: no vector, or a mask of another length.
            ConfigurationError: the call selects other environments while a mask is set.
        """
        mask = self.mask
        if mask is None:
            if env_ids is None:
                return Choice(None, self._num_envs, self._device, seen=not self.traced)
            return self._checked(env_ids)
        if env_ids is not None and len(env_ids) != len(mask):
            raise ConfigurationError(
                f"{len(env_ids)} of {len(mask)} environments are written under a mask: give env_ids as they came"
            )
        return Choice(mask, self._num_envs, self._device, seen=False)

    def rows(self, env_ids: Tensor | None) -> Tensor | None:
        """Return the rows of :meth:`choose`, for calls without values."""
        if env_ids is None:
            return self.mask
        return self.choose(env_ids).rows

    def _checked(self, env_ids: Tensor) -> Choice:
        known = self._known
        if known is not None and known[0] is env_ids and known[1] == env_ids._version:
            return Choice(env_ids, len(env_ids), self._device)
        check_index_tensor(env_ids, self._num_envs, self._device)
        if self.traced:
            return Choice(env_ids, len(env_ids), self._device, seen=False)
        if env_ids.dtype == torch.bool:
            return Choice(env_ids.nonzero().squeeze(-1), len(env_ids), self._device, taken=True)
        check_indices(env_ids, self._num_envs)
        if not env_ids.is_inference():  # those have no version
            self._known = env_ids, env_ids._version
        return Choice(env_ids, len(env_ids), self._device)
