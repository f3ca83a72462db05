"""Principal moments of inertia, and their rounding to moments that a solid can have.

No principal moment of a solid exceeds the sum of the other two. Those of a flat plate meet that bound, and their tensor
misses it by the last digit where it is rounded downwards.
"""

from __future__ import annotations

from itertools import permutations

import numpy as np
import numpy.typing as npt

from orbit_core.scene.pose import Pose

FloatArray = npt.NDArray[np.float64]

DOUBLE = 1e-12
"""Margin, as a share of the largest moment, that rounding to double precision leaves."""
SINGLE = 1e-6
"""Margin, as a share of the largest moment, that rounding to single precision leaves."""


def principal_axes(inertia: npt.ArrayLike) -> tuple[FloatArray, FloatArray]:
    """Return principal moments (3,), ascending, and the rotation (3, 3) whose columns are the principal axes."""
    moments, axes = np.linalg.eigh(np.asarray(inertia, dtype=float))
    # eigh may return a reflection; flipping one axis makes it a rotation.
    if np.linalg.det(axes) < 0:
        axes[:, 0] = -axes[:, 0]
    return moments, axes


def lacking_moment(moments: npt.ArrayLike) -> float:
    """Return the excess of the largest of three principal moments over the sum of the others, which may be negative."""
    small, middle, large = np.sort(np.asarray(moments, dtype=float))
    return float(large - small - middle)


def raised_moments(moments: npt.ArrayLike, margin: float = 0.0) -> FloatArray:
    """Return principal moments (3,) of which none is negative or exceeds the sum of the other two.

    Half of what lacks is added to each of the two smaller ones; the largest stays as it is.

    Args:
        moments: (3,) ascending.
        margin: by which the sum is to exceed the largest moment, as a share of it.
    """
    small, middle, large = np.maximum(np.asarray(moments, dtype=float), 0.0)
    lacking = max(0.0, large * (1.0 + margin) - small - middle) / 2.0
    return np.array((small + lacking, middle + lacking, large))


def solid_moments(inertia: npt.ArrayLike, margin: float = DOUBLE) -> tuple[FloatArray, Pose]:
    """Return the raised principal moments (3,) of a tensor, and the rotation that takes their axes to the tensor's.

    Each axis is the one nearest to the tensor's own, so that a diagonal tensor needs no rotation.

    Args:
        inertia: (3, 3) symmetric.
        margin: as of :func:`raised_moments`: the precision in which the moments are written or compared.
    """
    moments, axes = principal_axes(inertia)
    near = np.abs(axes)
    # eigh sorts by size; this order keeps the axes of a tensor that is diagonal already.
    order = max(permutations(range(3)), key=lambda columns: near[(0, 1, 2), columns].sum())
    axes = axes[:, order]
    axes = axes * np.where(np.diag(axes) < 0.0, -1.0, 1.0)
    if np.linalg.det(axes) < 0:
        axes[:, np.argmin(np.diag(axes))] *= -1.0
    return raised_moments(moments, margin)[list(order)], Pose.from_matrix(axes)
