"""Check of a scan's up axis by its floor, the height above it, and the sides that surfaces face."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from orbit_core.scene.pose import FloatArray

# Cosine of the largest angle between a level surface's normal and the vertical.
_LEVEL = math.cos(math.radians(15.0))
# Metres of height within which surfaces are one level; share of the fullest level that the lowest one, the floor, has.
_BIN, _SHARE = 0.05, 0.3
# Heights (m) of usual rooms, and the most that another height counts against a direction.
_USUAL, _MOST = (2.2, 3.2), 2.0
# Least floor (m^2) that another direction must have, and by how much its score must be better: rooms of 1.5 to 4 m in
# each direction read right differ by up to 0.76, furnished rooms read wrong by 0.9 to 3.
_LEAST_FLOOR, _MARGIN = 1.0, 0.8
# Metres above a floor between which furniture has its tops; least area (m^2), and the ratio to that of the other side,
# from which a room with a ceiling is upside down.
_TOPS, _LEAST_TOPS, _RATIO = (0.2, 1.5), 1.0, 3.0


@dataclass(frozen=True)
class Facing:
    """Evidence that a direction points up in a scan."""

    direction: tuple[int, int, int]
    """Unit vector along an axis of the scan."""
    floor: float
    """Area (m^2) of the lowest large level that faces this direction."""
    height: float
    """Metres of the scan above it."""
    balance: float
    """Area that faces this direction less that which faces the other one, as a share of both: -1 to 1."""
    tops: float
    """Area (m^2) that faces this direction at the height of furniture."""

    @property
    def score(self) -> float:
        """Large floors, usual heights and surfaces that face this direction rather than the other one count."""
        low, high = _USUAL
        unusual = min(max(low - self.height, self.height - high, 0.0), _MOST)
        return math.log(max(self.floor, 1e-6)) - unusual + self.balance


def better_up(vertices: FloatArray, corners: FloatArray) -> tuple[Facing, Facing] | None:
    """Return the evidence for z and for the direction that points up, where that is clearly another one.

    The floor of a scanned room is large, has the height of a room above it, and more surface faces up than down, for
    furniture is seen from above and ceilings are often left out. Closed empty rooms whose sides are as long as a room
    is high are taken as they are.

    Args:
        vertices: (V, 3) m, z up as the file was read.
        corners: (F, 3, 3) corners of the triangles, m.
    """
    a, b, c = np.moveaxis(corners, 1, 0)
    normals, middles = np.cross(b - a, c - a), corners.mean(1)
    found = {
        (axis, sign): each
        for axis in range(3)
        for sign in (1, -1)
        if (each := _facing(vertices, normals, middles, axis, sign)) is not None
    }
    given = found.pop((2, 1), Facing((0, 0, 1), 0.0, 0.0, -1.0, 0.0))
    below = found.pop((2, -1), None)
    if below and below.tops >= _LEAST_TOPS and below.tops > _RATIO * given.tops and below.floor >= _LEAST_FLOOR:
        return given, below
    better = [each for each in found.values() if each.floor >= _LEAST_FLOOR and each.score > given.score + _MARGIN]
    if not better:
        return None
    best = max(better, key=lambda each: each.score)
    # A ceiling is as large as the floor, and no furniture stands on it.
    ends = [each for each in better if np.abs(each.direction).tolist() == np.abs(best.direction).tolist()]
    return given, max(ends, key=lambda each: (each.tops, each.score))


def _facing(vertices: FloatArray, normals: FloatArray, middles: FloatArray, axis: int, sign: int) -> Facing | None:
    """Measure one direction; None where no surface faces it."""
    areas = np.linalg.norm(normals, axis=1) / 2.0
    cosines = sign * normals[:, axis] / np.maximum(2.0 * areas, 1e-12)
    level = cosines > _LEVEL
    if not level.any():
        return None
    heights = sign * middles[level, axis]
    first = heights.min()
    filled = np.bincount(((heights - first) / _BIN).astype(np.int64), areas[level])
    # A floor may straddle two bins.
    sums = filled + np.concatenate((filled[1:], [0.0]))
    lowest = int(np.flatnonzero(sums >= _SHARE * sums.max())[0])
    floor = first + (lowest + 0.5) * _BIN
    top = float(np.quantile(sign * vertices[:, axis], 0.99) - floor)
    toward, away = areas[level].sum(), areas[cosines < -_LEVEL].sum()
    at_tops = (heights > floor + _TOPS[0]) & (heights < floor + _TOPS[1])
    direction = tuple(sign if each == axis else 0 for each in range(3))
    return Facing(
        (direction[0], direction[1], direction[2]),
        float(sums[lowest]),
        top,
        float((toward - away) / (toward + away)),
        float(areas[level][at_tops].sum()),
    )
