"""Batched rotations and rigid transforms.

Quaternions (..., 4) are ``(w, x, y, z)``, poses (..., 7) position then quaternion. Leading dimensions broadcast.
Functions are written for few kernel launches: batches are large and steps are many.
"""

from __future__ import annotations

import math

import torch
from torch import Tensor


def quat_multiply(a: Tensor, b: Tensor) -> Tensor:
    """Return the rotation ``b`` followed by ``a``: (..., 4)."""
    aw, av = a[..., :1], a[..., 1:]
    bw, bv = b[..., :1], b[..., 1:]
    # torch.linalg.cross does not broadcast its arguments.
    av, bv = torch.broadcast_tensors(av, bv)
    w = aw * bw - (av * bv).sum(-1, keepdim=True)
    v = aw * bv + bw * av + torch.linalg.cross(av, bv)
    return torch.cat((w, v), -1)


def quat_conjugate(q: Tensor) -> Tensor:
    """Return the inverse rotation of unit quaternions (..., 4)."""
    return torch.cat((q[..., :1], -q[..., 1:]), -1)


def quat_rotate(q: Tensor, v: Tensor) -> Tensor:
    """Return vectors (..., 3) rotated by quaternions (..., 4)."""
    w, u = q[..., :1], q[..., 1:]
    u, v = torch.broadcast_tensors(u, v)
    t = torch.linalg.cross(u, v)
    t = t + t  # on few numbers a product with a number of Python takes twice as long
    return v + w * t + torch.linalg.cross(u, t)


def quat_rotate_inverse(q: Tensor, v: Tensor) -> Tensor:
    """Return vectors (..., 3) rotated by the inverse of quaternions (..., 4): world axes to the frame's own."""
    w, u = q[..., :1], q[..., 1:]
    u, v = torch.broadcast_tensors(u, v)
    t = torch.linalg.cross(u, v)
    t = t + t  # on few numbers a product with a number of Python takes twice as long
    return v - w * t + torch.linalg.cross(u, t)


def quat_canonical(q: Tensor) -> Tensor:
    """Return the same rotations with w >= 0 and unit length."""
    q = q / q.norm(dim=-1, keepdim=True)
    return torch.where(q[..., :1] < 0, -q, q)


def quat_to_matrix(q: Tensor) -> Tensor:
    """Return rotation matrices (..., 3, 3)."""
    w, x, y, z = q.unbind(-1)
    rows = (
        1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y),
        2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x),
        2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y),
    )  # fmt: skip
    return torch.stack(rows, -1).unflatten(-1, (3, 3))


def quat_from_matrix(m: Tensor) -> Tensor:
    """Return quaternions (..., 4), w >= 0, of rotation matrices (..., 3, 3), by Shepperd's method: no small divisor."""
    m00, m11, m22 = m[..., 0, 0], m[..., 1, 1], m[..., 2, 2]
    squares = torch.stack((1 + m00 + m11 + m22, 1 + m00 - m11 - m22, 1 - m00 + m11 - m22, 1 - m00 - m11 + m22), -1)
    wx, wy, wz = m[..., 2, 1] - m[..., 1, 2], m[..., 0, 2] - m[..., 2, 0], m[..., 1, 0] - m[..., 0, 1]
    xy, xz, yz = m[..., 0, 1] + m[..., 1, 0], m[..., 0, 2] + m[..., 2, 0], m[..., 1, 2] + m[..., 2, 1]
    s0, s1, s2, s3 = squares.unbind(-1)
    candidates = torch.stack(
        (
            torch.stack((s0, wx, wy, wz), -1),
            torch.stack((wx, s1, xy, xz), -1),
            torch.stack((wy, xy, s2, yz), -1),
            torch.stack((wz, xz, yz, s3), -1),
        ),
        -2,
    )
    best = squares.argmax(-1)[..., None, None].expand(*squares.shape[:-1], 1, 4)
    return quat_canonical(candidates.gather(-2, best).squeeze(-2))


def quat_from_rotation_vector(v: Tensor) -> Tensor:
    """Return quaternions (..., 4) of rotation vectors (..., 3): axis times angle."""
    angle = v.norm(dim=-1, keepdim=True)
    # sinc keeps the limit at zero: sin(a/2)/a = sinc(a/2pi)/2.
    return torch.cat(((0.5 * angle).cos(), 0.5 * torch.sinc(angle / (2 * math.pi)) * v), -1)


def quat_to_rotation_vector(q: Tensor) -> Tensor:
    """Return rotation vectors (..., 3), of length at most pi, of unit quaternions (..., 4)."""
    q = torch.where(q[..., :1] < 0, -q, q)
    sine = q[..., 1:].norm(dim=-1, keepdim=True)
    angle = 2.0 * torch.atan2(sine, q[..., :1])
    # Near zero the quotient of angle and sine tends to 2; where evaluates both branches, so that both must be finite.
    return torch.where(sine > 1e-7, angle / sine.clamp_min(1e-12), torch.full_like(sine, 2.0)) * q[..., 1:]


def rotation_angle(q: Tensor) -> Tensor:
    """Return (...) rad in [0, pi] by which unit quaternions (..., 4) turn."""
    return quat_to_rotation_vector(q).norm(dim=-1)


def quat_from_euler(roll: Tensor, pitch: Tensor, yaw: Tensor) -> Tensor:
    """Return quaternions (..., 4) of ``Rz(yaw) Ry(pitch) Rx(roll)``."""
    cr, sr, cp, sp = (0.5 * roll).cos(), (0.5 * roll).sin(), (0.5 * pitch).cos(), (0.5 * pitch).sin()
    cy, sy = (0.5 * yaw).cos(), (0.5 * yaw).sin()
    return torch.stack(
        (
            cr * cp * cy + sr * sp * sy,
            sr * cp * cy - cr * sp * sy,
            cr * sp * cy + sr * cp * sy,
            cr * cp * sy - sr * sp * cy,
        ),
        -1,
    )


def yaw_angle(q: Tensor) -> Tensor:
    """Return angles (...) in rad about z at which the x axes of rotations (..., 4) lie, seen from above."""
    w, x, y, z = q.unbind(-1)
    return torch.atan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z))


def quat_yaw(q: Tensor) -> Tensor:
    """Return the heading alone: rotations (..., 4) about z with the same yaw."""
    yaw = yaw_angle(q)
    zero = torch.zeros_like(yaw)
    return torch.stack(((0.5 * yaw).cos(), zero, zero, (0.5 * yaw).sin()), -1)


def quat_distance(a: Tensor, b: Tensor) -> Tensor:
    """Return the angle (...) in radians between rotations."""
    # The chord between the unit quaternions, and not the cosine of their angle, which is blind near zero in float32.
    chord = torch.minimum((a - b).norm(dim=-1), (a + b).norm(dim=-1))
    return 4.0 * torch.asin(0.5 * chord)


def rotation_error(current: Tensor, target: Tensor) -> Tensor:
    """Return the rotation vector (..., 3) in world axes that takes orientation ``current`` to ``target``."""
    return quat_to_rotation_vector(quat_multiply(target, quat_conjugate(current)))


def pose_multiply(a: Tensor, b: Tensor) -> Tensor:
    """Return pose ``b``, given in frame ``a``, in the parent of ``a``: (..., 7), quaternion canonical."""
    position = a[..., :3] + quat_rotate(a[..., 3:], b[..., :3])
    rotation = quat_multiply(a[..., 3:], b[..., 3:])
    return torch.cat((position, torch.where(rotation[..., :1] < 0, -rotation, rotation)), -1)


def pose_inverse(a: Tensor) -> Tensor:
    """Return the parent's pose (..., 7) in frame ``a``."""
    inverse = quat_conjugate(a[..., 3:])
    return torch.cat((-quat_rotate(inverse, a[..., :3]), inverse), -1)


def pose_error(current: Tensor, target: Tensor) -> Tensor:
    """Return position error, then rotation vector, (..., 6) in world axes, that take ``current`` to ``target``."""
    return torch.cat((target[..., :3] - current[..., :3], rotation_error(current[..., 3:], target[..., 3:])), -1)


def transform_points(pose: Tensor, points: Tensor) -> Tensor:
    """Return points (..., 3) of the frame ``pose`` in its parent."""
    return pose[..., :3] + quat_rotate(pose[..., 3:], points)
