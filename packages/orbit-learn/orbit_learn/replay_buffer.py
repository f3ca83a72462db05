"""Observations with what a teacher did in them, on the device, the oldest overwritten by the newest."""

from __future__ import annotations

from collections.abc import Mapping

import torch
from torch import Tensor

# How pictures are kept: depth to within half a millimetre in a metre, colours as they are.
_SHORT = {torch.float32: torch.float16}


class ReplayBuffer:
    """A ring of the last steps of all environments; nothing in it waits for the device.

    Args:
        capacity: steps of one environment that are kept; rounded down to whole steps of all.
        observation: an example, (N, ...): one tensor or a dictionary of terms.
        action_size: components of an action.
    """

    def __init__(self, capacity: int, observation: Tensor | Mapping[str, Tensor], action_size: int) -> None:
        terms = {"": observation} if isinstance(observation, Tensor) else dict(observation)
        first = next(iter(terms.values()))
        self._count, self._device = len(first), first.device
        rows = max(1, capacity // self._count) * self._count
        self._terms = {
            name: torch.zeros((rows, *value.shape[1:]), dtype=_kept_dtype(value), device=self._device)
            for name, value in terms.items()
        }
        self._dtypes = {name: value.dtype for name, value in terms.items()}
        self._actions = torch.zeros(rows, action_size, device=self._device)
        self._rows, self._next, self.size = rows, 0, 0

    def add(self, observation: Tensor | Mapping[str, Tensor], action: Tensor) -> None:
        """Copy one step of all environments."""
        terms = {"": observation} if isinstance(observation, Tensor) else observation
        rows = slice(self._next, self._next + self._count)
        for name, kept in self._terms.items():
            kept[rows] = terms[name]
        self._actions[rows] = action
        self._next = (self._next + self._count) % self._rows
        self.size = min(self.size + self._count, self._rows)

    def sample(self, count: int) -> tuple[Tensor | dict[str, Tensor], Tensor]:
        """Observations (count, ...) and actions (count, A), each drawn from all that is kept."""
        rows = torch.randint(self.size, (count,), device=self._device)
        terms = {name: kept[rows].to(self._dtypes[name]) for name, kept in self._terms.items()}
        return terms.get("", terms), self._actions[rows]


def _kept_dtype(value: Tensor) -> torch.dtype:
    return _SHORT.get(value.dtype, value.dtype) if value.dim() == 4 else value.dtype
