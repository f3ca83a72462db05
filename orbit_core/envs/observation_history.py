"""The last values of a measurement in each environment, for delays and histories."""

from __future__ import annotations

import torch
from torch import Tensor

from orbit_core.dynamics.indexing import write_rows
from orbit_core.interfaces import World


class Past:
    """The last values of each environment's episode; its first value stands for all before it.

    Args:
        world: whose resets begin episodes.
        value: (N, ...) one like those to come.
        length: how many values are kept.
    """

    def __init__(self, world: World, value: Tensor, length: int) -> None:
        self._selector = world.selector
        self._values = value.new_zeros(len(value), length, *value.shape[1:])
        """(N, length, ...), the newest first."""
        self._fresh = torch.ones(len(value), dtype=torch.bool, device=value.device)
        """(N,) whose episode has no value yet."""

    def reset(self, env_ids: Tensor | None) -> None:
        """Forget some environments' values, by index or mask."""
        write_rows(self._fresh, True, env_ids)

    def push(self, value: Tensor) -> Tensor:
        """Take in one step's value (N, ...); gives the last ones (N, length, ...), the newest first."""
        newest = value[:, None]
        shifted = torch.cat((newest, self._values[:, :-1]), dim=1)
        values = torch.where(self._fresh.view(-1, *(1 for _ in shifted.shape[1:])), newest, shifted)
        rows = self._selector.resolve(None)  # the others have been observed in this step already
        write_rows(self._values, values, rows)
        write_rows(self._fresh, False, rows)
        return values
