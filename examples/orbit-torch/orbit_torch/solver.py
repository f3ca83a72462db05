"""Impulses of contacts, joints' stops and joints' friction.

Accelerated projected gradient descent after H. Mazhar et al., Using Nesterov's method to accelerate multibody dynamics
with friction and contact (2015), with Coulomb's cylinder about the normal impulse of the iteration in the cone's place.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

_ITERATIONS = 60


@dataclass
class Rows:
    """What resists motion: R rows of joints, then C contacts of three rows each, world axes."""

    jacobian: Tensor
    """(N, R + 3 C, D): rates of the rows from generalised velocities."""
    target: Tensor
    """(N, R + 3 C) rates that the rows are pushed to, at least."""
    least: Tensor
    """(R,) smallest impulse of the joints' rows."""
    greatest: Tensor
    """(R,)"""
    normal: Tensor
    """(N, C, 3)"""
    friction: Tensor
    """(N, C) coefficient."""


def solve(rows: Rows, inverse_mass: Tensor, velocity: Tensor, impulses: Tensor) -> Tensor:
    """Impulses (N, R + 3 C) under which no row is slower than its target; begins with those of the step before."""
    offset = (rows.jacobian @ velocity[..., None])[..., 0] - rows.target
    bounds = rows.least, rows.greatest, rows.normal, rows.friction
    if not project(-offset, *bounds).any() and not impulses.any():
        return impulses  # nothing is near
    response = rows.jacobian @ inverse_mass @ rows.jacobian.mT
    # A row's own response becomes about one; the three of a contact share a scale, so that circles stay circles.
    own = response.diagonal(dim1=-2, dim2=-1).clamp_min(1e-12)
    joints = own[:, : len(rows.least)]
    contacts = own[:, len(rows.least) :].unflatten(1, (-1, 3)).mean(-1).repeat_interleave(3, 1)
    scale = torch.cat((joints, contacts), 1).rsqrt()
    response = scale[..., :, None] * response * scale[..., None, :]
    return descend(response, offset * scale, scale, impulses, *bounds, _ITERATIONS)


def project(impulses: Tensor, least: Tensor, greatest: Tensor, normal: Tensor, friction: Tensor) -> Tensor:
    """The nearest impulses that are allowed: joints' within bounds, contacts' pushing, friction within Coulomb's."""
    joints = torch.minimum(torch.maximum(impulses[:, : len(least)], least), greatest)
    contacts = impulses[:, len(least) :].reshape(normal.shape)
    along = (contacts * normal).sum(-1, keepdim=True)
    across = contacts - along * normal
    push = along.clamp_min(0.0)
    length = torch.linalg.vector_norm(across, dim=-1, keepdim=True).clamp_min(1e-30)
    share = (friction[..., None] * push / length).clamp_max(1.0)
    return torch.cat((joints, (push * normal + share * across).flatten(1)), 1)


def descend(
    response: Tensor, offset: Tensor, scale: Tensor, impulses: Tensor,
    least: Tensor, greatest: Tensor, normal: Tensor, friction: Tensor, iterations: int,
) -> Tensor:  # fmt: skip
    """The allowed impulses of least energy: ``response`` and ``offset`` are of impulses divided by ``scale``."""
    rate = 1.0 / response.abs().sum(-1).amax(-1, keepdim=True)
    found = impulses / scale
    ahead, momentum = found, torch.ones_like(rate)
    for _ in range(iterations):
        slope = torch.matmul(response, ahead[..., None])[..., 0] + offset
        after = project((ahead - rate * slope) * scale, least, greatest, normal, friction) / scale
        change = after - found
        if not change.any():
            break  # in every environment: none would move again
        uphill = (slope * change).sum(-1, keepdim=True) > 0.0
        momentum = momentum.masked_fill(uphill, 1.0)
        grown = 0.5 * (1.0 + (1.0 + 4.0 * momentum * momentum).sqrt())
        ahead = after + ((momentum - 1.0) / grown).masked_fill(uphill, 0.0) * change
        found, momentum = after, grown
    return found * scale
