"""How far shapes reach to the sides of a pinhole camera's picture."""

from __future__ import annotations

import torch
from torch import Tensor


def round_slopes(centres: Tensor, radii: Tensor, axes: Tensor) -> Tensor:
    """Left, top, right and bottom (..., 4) of points, discs and balls as x / depth and y / depth, y downwards.

    A plane through the camera that touches an ellipsoid ``c + A u, |u| <= 1`` has a normal m with ``(m c)^2 =
    |m A|^2``, a quadratic in the plane's slope: the dual quadric of Hartley and Zisserman, Multiple View Geometry, 2nd
    ed., section 8.3. Holds for what lies in front of the camera's centre.

    Args:
        centres: (..., 3) in the camera's frame, -z forward and y up.
        radii: (...,) zero for points.
        axes: (..., 3) unit normals of discs, zero for balls and points.
    """
    depth, normal = -centres[..., 2:], -axes[..., 2:]
    across = torch.stack((centres[..., 0], -centres[..., 1]), -1)
    tilt = torch.stack((axes[..., 0], -axes[..., 1]), -1)
    square = (radii * radii)[..., None]
    leading = depth**2 - square * (1.0 - normal**2)
    middle = across * depth + square * tilt * normal
    # The discriminant is written so that a point has exactly none: rounding would widen it by the root of 1e-7.
    turned = (depth * tilt - across * normal) ** 2
    spread = square * (depth**2 + across**2 - turned) - square**2 * (1.0 - tilt**2 - normal**2)
    root = spread.clamp_min(0.0).sqrt()
    return torch.cat((middle - root, middle + root), -1) / leading


def clipped_slopes(corners: Tensor, near: float) -> Tensor:
    """As :func:`round_slopes`, of the parts of boxes that lie in front of a plane: (..., 24, 4), infinite where none.

    Args:
        corners: (..., 8, 3) of the boxes in the camera's frame, z changing fastest.
        near: the plane's depth in metres.
    """
    first, second = _edges(corners)
    low, high = -first[..., 2:] - near, -second[..., 2:] - near
    share = low / torch.where(low == high, 1.0, low - high)
    crossing = first + share * (second - first)
    ends = torch.cat((torch.where(low < 0.0, crossing, first), torch.where(high < 0.0, crossing, second)), -2)
    seen = (low >= 0.0) | (high >= 0.0)
    seen = torch.cat((seen, seen), -2)
    slopes = torch.stack((ends[..., 0], -ends[..., 1]), -1) / (-ends[..., 2:]).clamp_min(0.5 * near)
    return torch.cat((torch.where(seen, slopes, torch.inf), torch.where(seen, slopes, -torch.inf)), -1)


def _edges(corners: Tensor) -> tuple[Tensor, Tensor]:
    """Both ends (..., 12, 3) of a box's edges."""
    x, y, z = (corners.unflatten(-2, (2, 2, 2)).unbind(axis) for axis in (-4, -3, -2))
    first, second = (torch.cat([along[end].flatten(-3, -2) for along in (x, y, z)], -2) for end in (0, 1))
    return first, second
