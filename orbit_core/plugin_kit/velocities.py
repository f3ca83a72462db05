"""Velocities at another point of a body, and which contacts count in a contact query."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import TYPE_CHECKING

import torch

if TYPE_CHECKING:
    from torch import Tensor

    from orbit_core.interfaces.layout import ContactQuery


def velocity_at(velocity: Tensor, arm: Tensor) -> Tensor:
    """The velocity (..., 6) of the point of a body that lies at ``arm`` (..., 3) from the one whose velocity is given.

    Linear, then angular, as ``arm`` in world axes: ``v + omega x arm``. From a link's origin to its centre of mass the
    arm is the rotated ``center_of_mass``; from the centre of mass back to the origin, its negative.
    """
    linear, angular = velocity[..., :3], velocity[..., 3:]
    return torch.cat((linear + torch.linalg.cross(*torch.broadcast_tensors(angular, arm)), angular), -1)


def contact_signs(queries: Sequence[ContactQuery], pairs: Iterable[tuple[int, int]]) -> Tensor:
    """What the force on the first link of each pair counts for in each query: (K, C) float64 of 1, -1 or 0.

    ``pairs`` are the C pairs of links that may touch, where ``TERRAIN`` stands for the terrain. With the forces
    (N, C, 3) on the first of each pair, ``contact_signs(...) @ forces`` is ``Engine.contact_forces``.
    """
    known = list(pairs)
    signs = [
        [_sign(query, first, second) - _sign(query, second, first) for first, second in known] for query in queries
    ]
    return torch.tensor(signs, dtype=torch.float64).view(len(signs), len(known))


def _sign(query: ContactQuery, felt_by: int, exerted_by: int) -> float:
    return float(felt_by == query.link and (query.others is None or exerted_by in query.others))
