"""Tensors as kernels take them."""

# pyright: reportArgumentType=false
# Warp's arrays carry their types at run time.

from __future__ import annotations

import warp as wp
from torch import Tensor


def array_of(values: Tensor | None, otherwise: wp.array) -> wp.array:
    """Return ``values`` as a kernel takes them; an empty array for None."""
    # Warp takes tensors without a copy, but kernels index them as if they were contiguous.
    return otherwise if values is None else wp.from_torch(values.contiguous())
