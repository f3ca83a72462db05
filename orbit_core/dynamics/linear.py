"""Small linear systems, batched, by operations that a CUDA graph can record."""

from __future__ import annotations

import torch
from torch import Tensor


def solve_spd(matrix: Tensor, right: Tensor) -> Tensor:
    """``matrix^-1 right`` (N, n, m) for symmetric positive definite matrices (N, n, n), by Cholesky's factors.

    Where a matrix is not positive definite the result is not finite; nothing waits for the device to tell.
    """
    factors, _ = torch.linalg.cholesky_ex(matrix)
    # Two triangular solves, for a CUDA graph cannot record torch.cholesky_solve.
    half = torch.linalg.solve_triangular(factors, right, upper=False)
    return torch.linalg.solve_triangular(factors.mT, half, upper=True)
