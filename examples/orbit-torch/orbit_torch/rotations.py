"""Quaternions (w, x, y, z)."""

from __future__ import annotations

import torch
from torch import Tensor


def multiply(a: Tensor, b: Tensor) -> Tensor:
    """Rotation b, then a."""
    w = a[..., :1] * b[..., :1] - (a[..., 1:] * b[..., 1:]).sum(-1, keepdim=True)
    xyz = a[..., :1] * b[..., 1:] + b[..., :1] * a[..., 1:] + cross(a[..., 1:], b[..., 1:])
    return torch.cat((w, xyz), -1)


def turn(rotation: Tensor) -> Tensor:
    """The quaternion of a rotation vector (..., 3)."""
    half = 0.5 * rotation.norm(dim=-1, keepdim=True)
    return torch.cat((half.cos(), 0.5 * torch.sinc(half / torch.pi) * rotation), -1)


def matrix(q: Tensor) -> Tensor:
    """(..., 3, 3): the axes of the turned frame are its columns."""
    w, v = q[..., :1, None], q[..., 1:]
    eye = torch.eye(3, dtype=q.dtype)
    skew = cross(v[..., None, :], eye).mT  # skew @ u is v x u
    return eye + 2.0 * (w * skew + skew @ skew)


def apply(rotation: Tensor, vectors: Tensor) -> Tensor:
    """Matrices (..., 3, 3) times vectors (..., 3)."""
    return (rotation @ vectors[..., None])[..., 0]


def cross(a: Tensor, b: Tensor) -> Tensor:
    """The vector product, over the last axis."""
    return torch.linalg.cross(*torch.broadcast_tensors(a, b))
