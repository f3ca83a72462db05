"""What rays meet, and rays that pass through what carries them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import torch
from torch import Tensor

from orbit_core.interfaces.layout import BACKGROUND

_MOST_SURFACES = 16  # a ray may cross that many surfaces to be passed before it counts as a miss
_PAST_SURFACE = 2e-5  # metres: what lies nearer than this behind a surface that is passed is passed too


@dataclass(frozen=True)
class RayHits:
    """The points at which rays met the scene."""

    distances: Tensor
    """(n, R) metres; infinite for a miss."""
    normals: Tensor
    """(n, R, 3) unit normals in world axes; zero for a miss."""
    links: Tensor
    """(n, R) int64 link index, TERRAIN or BACKGROUND."""


def cast_past(
    cast: Callable[[Tensor, Tensor, float, Tensor | None], RayHits],
    origins: Tensor,
    directions: Tensor,
    max_distance: float,
    links: range,
    env_ids: Tensor | None,
) -> RayHits:
    """Rays (n, R, 3) through the shapes of some links: those that met one are cast again from behind it."""
    hits = cast(origins, directions, max_distance, env_ids)
    distances, normals, met = hits.distances.clone(), hits.normals.clone(), hits.links.clone()
    own = _among(met, links)
    for _ in range(_MOST_SURFACES):
        if not own.any():
            break
        rays = own.any(0).nonzero().squeeze(-1)
        within = own[:, rays]  # of the same ray, another environment's may be through already
        start = torch.where(within, distances[:, rays] + _PAST_SURFACE, 0.0)
        moved = origins[:, rays] + start[..., None] * directions[:, rays]
        hits = cast(moved, directions[:, rays].contiguous(), max_distance, env_ids)
        distances[:, rays] = torch.where(within, start + hits.distances, distances[:, rays])
        normals[:, rays] = torch.where(within[..., None], hits.normals, normals[:, rays])
        met[:, rays] = torch.where(within, hits.links, met[:, rays])
        own = _among(met, links)
    missed = own | (distances > max_distance)
    distances[missed] = torch.inf
    normals[missed] = 0.0
    met[missed] = BACKGROUND
    return RayHits(distances, normals, met)


def _among(met: Tensor, links: range) -> Tensor:
    return (met >= links.start) & (met < links.stop)
