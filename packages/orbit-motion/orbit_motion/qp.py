"""Small quadratic programs, batched, by a fixed number of iterations that a captured step can hold."""

from __future__ import annotations

import torch
from torch import Tensor

from orbit_core.dynamics.linear import solve_spd

_RELAXATION = 1.6
_PROXIMAL = 1e-6
# How much harder equations are held than inequalities.
_EQUAL = 1e3


def solve_qp(
    quadratic: Tensor, linear: Tensor, matrix: Tensor, lower: Tensor, upper: Tensor, iterations: int = 60
) -> Tensor:
    """(N, n) x that minimises ``x^T P x / 2 + q^T x`` where ``lower <= A x <= upper``.

    The alternating direction method of multipliers as in OSQP (Stellato et al., OSQP: An Operator Splitting Solver for
    Quadratic Programs, Mathematical Programming Computation 12, 2020, algorithm 1), all programs at once. What it gives
    after ``iterations`` meets the bounds up to what has not converged: clip what must not exceed them.

    Args:
        quadratic: P (N, n, n), symmetric and positive semidefinite.
        linear: q (N, n).
        matrix: A (N, m, n).
        lower: (N, m), -inf where there is none.
        upper: (N, m), inf where there is none; an equation has the same bound twice.
        iterations: of the method.
    """
    count = quadratic.shape[-1]
    size = quadratic.diagonal(dim1=1, dim2=2).mean(1, keepdim=True).clamp_min(1e-9)
    steps = torch.where(lower == upper, _EQUAL, 1.0) * size
    identity = torch.eye(count, device=quadratic.device, dtype=quadratic.dtype)
    system = quadratic + _PROXIMAL * size.unsqueeze(-1) * identity + matrix.mT @ (steps.unsqueeze(-1) * matrix)
    inverse = solve_spd(system, identity.expand_as(system))
    x, z, y = torch.zeros_like(linear), torch.zeros_like(lower), torch.zeros_like(lower)
    for _ in range(iterations):
        right = _PROXIMAL * size * x - linear + _times(matrix.mT, steps * z - y)
        guess = _times(inverse, right)
        x = _RELAXATION * guess + (1.0 - _RELAXATION) * x
        moved = _RELAXATION * _times(matrix, guess) + (1.0 - _RELAXATION) * z
        z = torch.clamp(moved + y / steps, lower, upper)
        y = y + steps * (moved - z)
    return x


def _times(matrix: Tensor, vector: Tensor) -> Tensor:
    return torch.bmm(matrix, vector.unsqueeze(-1)).squeeze(-1)
