"""What a sensor remembers from one measurement to the next."""

from __future__ import annotations

from collections.abc import Iterator, MutableMapping

import torch
from torch import Tensor

from orbit_core.dynamics.indexing import is_mask
from orbit_core.interfaces.capture import is_tracing, report_new_memory


class Memory(MutableMapping[str, Tensor]):
    """Tensors by name. A tensor that was handed out stays as it was: another is put in its place.

    From the first step on that is traced they are written in place instead, for a trace repeats what it did to the very
    same memory: clone then what you keep.
    """

    def __init__(self) -> None:
        self._tensors: dict[str, Tensor] = {}
        self._pinned = False

    def __getitem__(self, name: str) -> Tensor:
        return self._tensors[name]

    def __setitem__(self, name: str, value: Tensor) -> None:
        self._pinned |= is_tracing()
        own = self._tensors.get(name)
        if own is not None and self._pinned:
            own.copy_(value)
        else:  # what is expanded has several elements at one place, and cannot be written
            self._tensors[name] = value.clone() if 0 in value.stride() else value
            report_new_memory()

    def __delitem__(self, name: str) -> None:
        del self._tensors[name]

    def __iter__(self) -> Iterator[str]:
        return iter(self._tensors)

    def __len__(self) -> int:
        return len(self._tensors)

    def saved(self) -> dict[str, Tensor]:
        """A detached copy."""
        return {name: tensor.clone() for name, tensor in self._tensors.items()}

    def load(self, saved: dict[str, Tensor]) -> None:
        """Return to a copy."""
        for name in self._tensors.keys() - saved.keys():
            del self._tensors[name]
        for name, tensor in saved.items():
            self[name] = tensor.clone()


def with_rows(old: Tensor, values: Tensor, env_ids: Tensor | None, dim: int = 0) -> Tensor:
    """``old`` with the values of some environments, which dimension ``dim`` counts, by index or by mask (N,)."""
    if env_ids is None:
        return values
    if is_mask(env_ids):
        return torch.where(env_ids.view(-1, *(1 for _ in old.shape[dim + 1 :])), values, old)
    return old.index_copy(dim, env_ids, values.expand(*old.shape[:dim], *values.shape[dim:]).contiguous())
