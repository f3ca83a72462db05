"""Numbers of Python as tensors that are made once.

An operation on few numbers takes two to three times as long with a number of Python, which torch makes a tensor of and
promotes at each call, as with a tensor.
"""

from __future__ import annotations

from functools import lru_cache

import torch
from torch import Tensor


# Bounded, because a value may follow a curriculum.
@lru_cache(maxsize=1024)
def constant(value: float | tuple[float, ...], device: torch.device) -> Tensor:
    """Return a float32 tensor, () of a number or (k,) of several; never written to."""
    return torch.tensor(value, dtype=torch.float32, device=device)
