"""Impulses of contacts, joints' stops and joints' friction.

Accelerated projected gradient descent after H. Mazhar et al., Using Nesterov's method to accelerate multibody dynamics
with friction and contact (2015), with Coulomb's cylinder about the normal impulse of the iteration in the cone's place.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

_ITERATIONS = 80


@dataclass
class Rows:
    """What resists motion: R scalar rows of joints, then C contacts of three rows each, world axes."""

    jacobian: Tensor
    """(N, R + 3 C, D): rates of the rows from generalised velocities."""
    target: Tensor
    """(N, R + 3 C) rates that the rows are pushed to, at least."""
    lower: Tensor
    """(R,) least impulse of the joints' rows."""
    upper: Tensor
    """(R,) greatest impulse."""
    normal: Tensor
    """(N, C, 3)"""
    friction: Tensor
    """(N, C) coefficient."""


def solve(rows: Rows, inverse_mass: Tensor, velocity: Tensor, impulses: Tensor) -> Tensor:
    """Impulses (N, R + 3 C) under which no row is slower than its target; begins with those of the step before."""
    offset = (rows.jacobian @ velocity[..., None])[..., 0] - rows.target
    if not (_project(-offset, rows) != 0.0).any() and not impulses.any():
        return impulses  # nothing is near: no step of the descent would move
    response = rows.jacobian @ inverse_mass @ rows.jacobian.mT
    scale = _scale(response, len(rows.lower))
    response = scale[..., :, None] * response * scale[..., None, :]
    offset = offset * scale
    rate = 1.0 / response.abs().sum(-1).amax(-1, keepdim=True).clamp_min(1e-12)
    found = impulses / scale
    ahead, momentum = found, torch.ones_like(rate)
    for _ in range(_ITERATIONS):
        slope = (response @ ahead[..., None])[..., 0] + offset
        after = _project((ahead - rate * slope) * scale, rows) / scale
        change = after - found
        restart = (slope * change).sum(-1, keepdim=True) > 0.0
        momentum = torch.where(restart, 1.0, momentum)
        grown = 0.5 * (1.0 + (1.0 + 4.0 * momentum**2).sqrt())
        ahead = after + torch.where(restart, 0.0, (momentum - 1.0) / grown) * change
        found, momentum = after, grown
    return found * scale


def _scale(response: Tensor, joint_rows: int) -> Tensor:
    """Brings every row's own response to about one; the three of a contact alike, so that circles stay circles."""
    own = response.diagonal(dim1=-2, dim2=-1).clamp_min(1e-12)
    contacts = own[:, joint_rows:].unflatten(1, (-1, 3)).mean(-1).repeat_interleave(3, 1)
    return torch.cat((own[:, :joint_rows], contacts), 1).rsqrt()


def _project(impulses: Tensor, rows: Rows) -> Tensor:
    """The nearest impulses that are allowed: joints' within bounds, contacts' pushing, friction within Coulomb's."""
    count = len(rows.lower)
    joints = torch.minimum(torch.maximum(impulses[:, :count], rows.lower), rows.upper)
    contacts = impulses[:, count:].unflatten(1, (-1, 3))
    along = (contacts * rows.normal).sum(-1, keepdim=True)
    push = along.clamp_min(0.0)
    across = contacts - along * rows.normal
    length = across.norm(dim=-1, keepdim=True)
    bound = rows.friction[..., None] * push
    across = across * (bound / length.clamp_min(1e-30)).clamp_max(1.0)
    return torch.cat((joints, (push * rows.normal + across).flatten(1)), 1)
