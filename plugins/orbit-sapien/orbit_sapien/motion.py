"""Velocities of free bodies, computed from the motion of the last step.

PhysX's TGS solver moves bodies in as many small steps as it has position iterations, and keeps the velocity of the
last one: under load that is off by some cm/s, even where nothing moves. Over the whole step a body moved at the mean of
those velocities, which is what engines report whose poses follow from one velocity a step. PhysX's own number stands
where there is but one, without contacts, for poses are rounded to single precision; and after a blow, for then the mean
is of before and after.
"""

from __future__ import annotations

import torch
from torch import Tensor

from orbit_sapien.kinematics import multiply, rotate

# What a difference of two poses is off by, relative to their numbers, or to one where those are less.
_ROUNDING = 5e-7
# Change of speed in one step, m/s, above which a body was struck: several times what PhysX's velocities of resting
# bodies are off by.
_BLOW = 0.1


def moved_velocities(before: Tensor, after: Tensor, centers: Tensor, dt: float) -> Tensor:
    """(N, E, 6), linear and angular, of centres of mass (N, E, 3) in their bodies, world axes.

    ``before`` and ``after`` (N, E, 13) are unit quaternions, positions and PhysX's velocities around a step of ``dt``
    seconds.
    """
    turn = multiply(after[..., :4], before[..., :4] * before.new_tensor([1.0, -1.0, -1.0, -1.0]))
    arms = rotate(after[..., :4], centers) - rotate(before[..., :4], centers)
    way = after[..., 4:7] - before[..., 4:7] + arms
    moved = torch.cat((way, _rotation_vector(turn)), -1) / dt
    own = after[..., 7:]
    size = torch.cat((after[..., 4:7].abs(), torch.zeros_like(way)), -1)
    agree = (own - moved).abs() <= _ROUNDING * size.clamp_min(1.0) / dt + 1e-4 * own.abs()
    struck = (own - before[..., 7:])[..., :3].norm(dim=-1, keepdim=True) > _BLOW
    return torch.where(agree | struck, own, moved)


def _rotation_vector(q: Tensor) -> Tensor:
    """Axis times angle (..., 3) in radians of unit quaternions (..., 4), by the shorter way."""
    sine = q[..., 1:].norm(dim=-1, keepdim=True)
    angle = 2.0 * torch.atan2(sine, q[..., :1].abs())
    return q[..., 1:] * (torch.where(q[..., :1] < 0, -angle, angle) / sine.clamp_min(1e-30))
