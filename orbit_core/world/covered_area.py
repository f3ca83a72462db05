"""How much of the ground a cloth covers, seen from above."""

from __future__ import annotations

import math

import numpy as np
import torch
from torch import Tensor

from orbit_core.scene import Cloth

_CELLS_PER_EDGE = 6
"""Cells of the grid along a triangle's longest edge."""
_STRETCH = 1.25
"""By how much an edge may be longer than at rest and still be seen whole."""


class CoveredArea:
    """Counts the cells of a grid, which lies around the cloth's middle, whose centres some triangle covers.

    Without a loop over environments or triangles: each triangle looks at the cells of a window that it fits into.
    """

    def __init__(self, cloth: Cloth, device: torch.device) -> None:
        vertices, faces = cloth.rest_positions, np.asarray(cloth.mesh.faces)
        corners = vertices[faces]
        longest = float(np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=-1).max())
        self._cell = longest / _CELLS_PER_EDGE
        """Metres."""
        span = float(np.linalg.norm(vertices.max(0) - vertices.min(0))) * _STRETCH
        self._count = math.ceil(2.0 * span / self._cell)
        """Cells along each side; the grid holds the cloth wherever its middle lies."""
        window = math.ceil(_CELLS_PER_EDGE * _STRETCH) + 1
        steps = torch.arange(window, device=device)
        self._window = torch.cartesian_prod(steps, steps)
        """(W, 2) cells from a triangle's lowest corner on."""
        self._faces = torch.as_tensor(faces, dtype=torch.int64, device=device)

    def __call__(self, positions: Tensor) -> Tensor:
        """(N,) m^2 of particles (N, P, 3)."""
        flat = positions[..., :2]
        origin = flat.mean(1, keepdim=True) - 0.5 * self._count * self._cell
        corners = ((flat - origin) / self._cell)[:, self._faces]  # (N, T, 3, 2) in cells
        cells = corners.amin(2).floor().long()[:, :, None] + self._window  # (N, T, W, 2)
        inside = _covered(corners[:, :, None], cells + 0.5)
        on_grid = ((cells >= 0) & (cells < self._count)).all(-1)
        flat_cells = (cells[..., 0] * self._count + cells[..., 1]).clamp(0, self._count**2 - 1)
        seen = torch.zeros(len(positions), self._count**2, device=positions.device)
        seen.scatter_reduce_(1, flat_cells.flatten(1), (inside & on_grid).float().flatten(1), "amax")
        return seen.sum(1) * self._cell**2


def _covered(corners: Tensor, points: Tensor) -> Tensor:
    """Whether points (N, T, W, 2) lie in triangles (N, T, 1, 3, 2), whichever way round these go."""
    edges = torch.roll(corners, -1, dims=3) - corners
    arms = points[..., None, :] - corners
    sides = edges[..., 0] * arms[..., 1] - edges[..., 1] * arms[..., 0]
    return (sides >= 0.0).all(-1) | (sides <= 0.0).all(-1)
