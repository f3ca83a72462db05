"""Extents of the grids of maps (``maps.py``), and which shapes are small enough for one."""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt

from orbit_matter.fluid.fluids import SMOOTHING

FloatArray = npt.NDArray[np.floating]

FINENESS = 0.4
"""Spacings between points of a grid."""
MOST_POINTS = 4_000_000
"""Most points of a grid: 16 MB, and of those near the surface 60 bytes each. At a spacing of 1 cm a height field of
1.1 x 1.1 m with a relief of 10 cm has them."""
_MARGIN = 2.0 * (2.0 * SMOOTHING + FINENESS)
"""Spacings by which a grid is longer than what it is around."""


def points_of(corners: FloatArray, spacing: float) -> tuple[int, int, int]:
    """Return the points along each axis of the grid around corners (n, 3) in metres."""
    extent = np.ptp(np.asarray(corners, float), axis=0) + _MARGIN * spacing
    x, y, z = (int(count) + 1 for count in np.ceil(extent / (FINENESS * spacing)))
    return x, y, z


def is_mappable(corners: FloatArray, spacing: float) -> bool:
    """Return True if the grid around corners (n, 3) has no more than MOST_POINTS."""
    return math.prod(points_of(corners, spacing)) <= MOST_POINTS


def widest_of(height: float, spacing: float) -> float:
    """Return the side in metres of the largest square that has a grid, for what is so high; 0 where none has."""
    layers = math.ceil(height / (FINENESS * spacing) + _MARGIN / FINENESS) + 1
    # One point less, as lengths are rounded up.
    return max((math.isqrt(MOST_POINTS // layers) - 2) * FINENESS * spacing - _MARGIN * spacing, 0.0)
