"""Triangles that show a deformable, from its particles, for every renderer and viewer alike."""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor

from orbit_core.scene import DeformableSpec, Fluid, Rope

_SIDES = 8
"""Of the prism that stands for a piece of rope."""


class DeformableSurface:
    """Cloth and soft bodies are their meshes; a rope is a prism for each piece, a fluid an octahedron a particle."""

    def __init__(self, spec: DeformableSpec) -> None:
        self._spec = spec
        self.faces = _faces(spec)
        """(F, 3) of indices into the vertices; seen from both sides."""

    def vertices(self, positions: Tensor) -> Tensor:
        """(n, V, 3) of particles (n, P, 3)."""
        if isinstance(self._spec, Rope):
            return _prisms(positions, self._spec.radius)
        if isinstance(self._spec, Fluid):
            corners = torch.eye(3, device=positions.device) * (0.5 * self._spec.spacing)
            return (positions[:, :, None] + torch.cat((corners, -corners))).flatten(1, 2)
        return positions


def _faces(spec: DeformableSpec) -> npt.NDArray[np.int64]:
    if isinstance(spec, Rope):
        start = 2 * _SIDES * np.arange(len(spec.rest_positions) - 1)[:, None, None]
        side = np.arange(_SIDES)
        following = (side + 1) % _SIDES
        lower = np.stack((side, following, following + _SIDES), axis=-1)
        upper = np.stack((side, following + _SIDES, side + _SIDES), axis=-1)
        return (start + np.concatenate((lower, upper))).reshape(-1, 3)
    if isinstance(spec, Fluid):
        start = 6 * np.arange(len(spec.rest_positions))[:, None, None]
        eight = [(0, 1, 2), (1, 3, 2), (3, 4, 2), (4, 0, 2), (1, 0, 5), (3, 1, 5), (4, 3, 5), (0, 4, 5)]
        return (start + np.array(eight)).reshape(-1, 3)
    return np.asarray(spec.mesh.faces, dtype=np.int64)


def _prisms(points: Tensor, radius: float) -> Tensor:
    """(n, (P - 1) 2 sides, 3): two rings around each piece, across it."""
    along = points[:, 1:] - points[:, :-1]
    along = along / along.norm(dim=-1, keepdim=True).clamp_min(1e-12)
    # Any direction that is not along: the axis that is least so.
    other = torch.nn.functional.one_hot(along.abs().argmin(-1), 3).to(along.dtype)
    first = torch.linalg.cross(along, other)
    first = first / first.norm(dim=-1, keepdim=True)
    second = torch.linalg.cross(along, first)
    angles = torch.arange(_SIDES, device=points.device) * (2.0 * math.pi / _SIDES)
    ring = radius * (first[:, :, None] * angles.cos()[:, None] + second[:, :, None] * angles.sin()[:, None])
    return torch.cat((points[:, :-1, None] + ring, points[:, 1:, None] + ring), dim=2).flatten(1, 2)
