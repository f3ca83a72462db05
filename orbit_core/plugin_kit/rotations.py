"""Rigid transforms of NumPy arrays: vectors (..., 3) and unit quaternions (..., 4) as (w, x, y, z)."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

FloatArray = npt.NDArray[np.floating]


def rotate(quaternions: FloatArray, vectors: FloatArray) -> FloatArray:
    """Return vectors of a rotated frame in its parent's axes."""
    real, imaginary = quaternions[..., :1], quaternions[..., 1:]
    # v + 2 w (u x v) + 2 u x (u x v): a third of the operations of a rotation matrix.
    swept = cross(imaginary, vectors)
    return vectors + 2.0 * (real * swept + cross(imaginary, swept))


def rotate_inverse(quaternions: FloatArray, vectors: FloatArray) -> FloatArray:
    """Return vectors of the parent's axes in the rotated frame's."""
    return rotate(np.concatenate((quaternions[..., :1], -quaternions[..., 1:]), -1), vectors)


def multiply(first: FloatArray, second: FloatArray) -> FloatArray:
    """Return the rotation ``second``, then ``first``."""
    a, b = first[..., :1], first[..., 1:]
    c, d = second[..., :1], second[..., 1:]
    real = a * c - (b * d).sum(-1, keepdims=True)
    return np.concatenate((real, a * d + c * b + cross(b, d)), -1)


def cross(first: FloatArray, second: FloatArray) -> FloatArray:
    """Return the cross product, without the overhead of :func:`numpy.cross`."""
    first, second = np.broadcast_arrays(first, second)
    result = np.empty(first.shape)
    for i, j, k in ((0, 1, 2), (1, 2, 0), (2, 0, 1)):
        result[..., i] = first[..., j] * second[..., k] - first[..., k] * second[..., j]
    return result


def compose(positions: FloatArray, quaternions: FloatArray, offset: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the pose ``offset`` (..., 7), given in frames at ``positions`` with ``quaternions``, in their parent."""
    return positions + rotate(quaternions, offset[..., :3]), multiply(quaternions, offset[..., 3:])
