"""Rotations of many vectors in double precision, for what is written into MuJoCo's rows."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

FloatArray = npt.NDArray[np.float64]


def rotate(quaternions: FloatArray, vectors: FloatArray) -> FloatArray:
    """Vectors (n, 3) turned by unit quaternions (n, 4), ``(w, x, y, z)``."""
    return _rotate(quaternions[:, :1], quaternions[:, 1:], vectors)


def rotate_inverse(quaternions: FloatArray, vectors: FloatArray) -> FloatArray:
    """Vectors (n, 3) turned back by unit quaternions (n, 4)."""
    return _rotate(quaternions[:, :1], -quaternions[:, 1:], vectors)


def _rotate(w: FloatArray, u: FloatArray, vectors: FloatArray) -> FloatArray:
    t = 2.0 * np.cross(u, vectors)
    return vectors + w * t + np.cross(u, t)
