"""Small linear systems, batched, by operations that a CUDA graph can record."""

from __future__ import annotations

import functools

import torch
from torch import Tensor


def solve_spd(matrix: Tensor, right: Tensor) -> Tensor:
    """Return ``matrix^-1 right`` (N, n, m) for symmetric positive definite matrices (N, n, n), by Cholesky's factors.

    Where a matrix is not positive definite the result is not finite; no check waits for the device.
    """
    factors, _ = torch.linalg.cholesky_ex(matrix)
    # Two triangular solves, for a CUDA graph cannot record torch.cholesky_solve.
    half = torch.linalg.solve_triangular(factors, right, upper=False)
    return torch.linalg.solve_triangular(factors.mT, half, upper=True)


@functools.cache
def products_ignore_other_rows() -> bool:
    """Return True if a row of a matrix product on the CPU has the same bits however many other rows there are.

    Multiplies matrices of the sizes of observations and small networks once a process. False where MKL made a product
    before ``orbit_core`` was imported, or with libraries that have no mode for it.
    """
    numbers = torch.linspace(-1.0, 1.0, 64 * 64).reshape(64, 64).sin()
    for inner, outer in ((3, 3), (9, 40), (38, 64)):
        rows, weights, bias = numbers[:, :inner], numbers[:inner, :outer].contiguous(), numbers[0, :outer]
        few, many = rows[:1].contiguous(), rows.contiguous()
        if not torch.equal(few @ weights, (many @ weights)[:1]):
            return False
        if not torch.equal(torch.addmm(bias, few, weights), torch.addmm(bias, many, weights)[:1]):
            return False
    return True
