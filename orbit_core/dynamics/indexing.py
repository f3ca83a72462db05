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
from orbit_core.interfaces.capture import is_tracing
from orbit_core.plugin_kit.rows import is_mask, take_rows, write_columns, write_rows

__all__ = [
    "ColumnView", "Columns", "RowSelection", "RowSelector", "columns_of", "is_mask", "take_rows", "write_block",
    "write_columns", "write_rows",
]  # fmt: skip

Columns = slice | Tensor
"""What ``tensor[:, columns]`` takes."""


def columns_of(indices: Sequence[int], device: torch.device) -> Columns:
    """Return indices as a slice if they are consecutive, since a view costs less than a gather; else a tensor (k,)."""
    first = indices[0] if indices else 0
    # Joints of one robot are nearly always adjacent, so that most reads and writes become views.
    if list(indices) == list(range(first, first + len(indices))):
        return slice(first, first + len(indices))
    return torch.tensor(list(indices), dtype=torch.int64, device=device)


class ColumnView:
    """Some columns of tensors (N, J), viewed once for each tensor that is given, as most engines return the same one.

    Args:
        columns: slice, or indices (k,), which are gathered at each read.
    """

    __slots__ = ("_columns", "_own", "_whole")

    def __init__(self, columns: Columns) -> None:
        self._columns = columns
        self._whole: Tensor | None = None
        self._own: Tensor | None = None

    def read(self, whole: Tensor) -> Tensor:
        """Return the columns (N, k) of a tensor (N, J)."""
        if not isinstance(self._columns, slice):
            return whole[:, self._columns]
        if self._own is None or whole is not self._whole:
            self._whole, self._own = whole, whole[:, self._columns]
        return self._own

    def write(self, whole: Tensor, values: Tensor) -> None:
        """Write values (N, k) into the columns of a tensor (N, J)."""
        if isinstance(self._columns, slice):
            self.read(whole).copy_(values)
        else:
            whole[:, self._columns] = values


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
class RowSelection:
    """Environments that a call is for, and checks of the values that come with it."""

    rows: Tensor | None
    """Indices (n,), a mask (N,) bool within a traced step, None for all: the form that engines take."""
    count: int
    """Rows that are given of each value."""
    device: torch.device
    """Device that values are moved to."""
    taken: bool = False
    """True if values are given for all environments, and those of ``rows`` must be taken."""
    masked: bool = False
    """True if rows outside of a mask count for nothing, so that their numbers are not checked."""

    @property
    def readable(self) -> bool:
        """True if numbers of the values may be looked at: not under a mask, and not in a traced step."""
        return not (self.masked or is_tracing())

    def values(self, value: Tensor, shape: tuple[int, ...], what: str, bounds: Bounds) -> Tensor:
        """Return numbers (n, *shape) in the form that an engine takes: float32, on the device, without gradient.

        Args:
            value: given by a caller.
            shape: of one environment's value.
            what: name of the value, for messages.
            bounds: of each number.

        Raises:
            ArgumentError: another type, dtype or device, or out of bounds.
            ShapeError: another shape.
            NonFiniteError: NaN or infinite.
        """
        value = as_floats(value, self.device, what)
        check_shape(value, (self.count, *shape), what)
        if self.taken:
            value = value[self.rows]
        if self.readable:
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
        if self.readable and not bool(((value >= least) & (value <= most)).all()):
            raise ArgumentError(f"{what} are indices from {least} to {most}, not {value.flatten().tolist()[:8]}")
        return value

    def poses(self, pose: Tensor, what: str) -> Tensor:
        """Return poses (n, 7); errors as of :meth:`values`, and for quaternions that are not of length 1."""
        pose = self.values(pose, (7,), what, POSITIONS)
        if self.readable:
            check_quaternions(pose, what, self.rows)
        return pose


class RowSelector:
    """Check of the environments that calls are for; under a mask, restricts every call to the environments in it.

    A captured step resets by mask: events are given the indices of all environments, so that they run without knowing
    how many episodes ended, and what they write or draw counts for the environments of the mask only.

    Args:
        num_envs: number of environments, N.
        device: of the tensors that callers give.
    """

    def __init__(self, num_envs: int, device: torch.device) -> None:
        self.mask: Tensor | None = None
        """(N,) bool"""
        self._all = torch.arange(num_envs, device=device)
        self._num_envs = num_envs
        self._device = device
        # Indices that were checked, and their version, since one selection goes through many calls.
        self._known: tuple[Tensor, int] | None = None

    @contextmanager
    def only(self, mask: Tensor | None) -> Iterator[None]:
        """Set a mask (N,) in the place of the present one; None lifts it."""
        before, self.mask = self.mask, mask
        try:
            yield
        finally:
            self.mask = before

    @contextmanager
    def given(self, env_ids: Tensor | None) -> Iterator[Tensor]:
        """Yield indices of environments (n,) for code that takes indices; for a mask (N,) all indices, under the mask.

        Args:
            env_ids: indices, a mask, or None for all environments.
        """
        if is_mask(env_ids):
            with self.only(env_ids):
                yield self._all
        else:
            yield self._all if env_ids is None else env_ids

    def where(self, mask: Tensor) -> Tensor | None:
        """Return the environments of a mask (N,) as indices (n,), None if there are none; in a traced step the mask.

        A traced step must not look at what the mask holds; elsewhere the look saves the work if no row is set.
        """
        if is_tracing():
            return mask
        rows = mask.nonzero().squeeze(-1)
        return rows if len(rows) else None

    def select(self, env_ids: Tensor | None) -> RowSelection:
        """Return the environments that a call for ``env_ids`` means: they themselves, or the mask that is set.

        A mask that a caller gives comes with values of all environments; outside of a traced step its indices are
        taken.

        Raises:
            ArgumentError: no environments: of another type, dtype or device, out of range, or one twice.
            ShapeError: no vector, or a mask of another length.
            ConfigurationError: the call selects other environments while a mask is set.
        """
        mask = self.mask
        if mask is None:
            return RowSelection(None, self._num_envs, self._device) if env_ids is None else self._checked(env_ids)
        # Events get all indices under a mask; other indices mean that the caller chose rows by numbers, which a trace
        # would freeze.
        if env_ids is not None and len(env_ids) != len(mask):
            raise ConfigurationError(
                f"{len(env_ids)} of {len(mask)} environments are written under a mask: give env_ids as they came"
            )
        return RowSelection(mask, self._num_envs, self._device, masked=True)

    def resolve(self, env_ids: Tensor | None) -> Tensor | None:
        """Return the rows of :meth:`select`, for a call that comes without values."""
        return self.mask if env_ids is None else self.select(env_ids).rows

    def _checked(self, env_ids: Tensor) -> RowSelection:
        known = self._known
        if known is not None and known[0] is env_ids and known[1] == env_ids._version:
            return RowSelection(env_ids, len(env_ids), self._device)
        check_index_tensor(env_ids, self._num_envs, self._device)
        if is_tracing():
            return RowSelection(env_ids, len(env_ids), self._device)
        if env_ids.dtype == torch.bool:
            return RowSelection(env_ids.nonzero().squeeze(-1), len(env_ids), self._device, taken=True)
        check_indices(env_ids, self._num_envs)
        if not env_ids.is_inference():  # those have no version
            self._known = env_ids, env_ids._version
        return RowSelection(env_ids, len(env_ids), self._device)
