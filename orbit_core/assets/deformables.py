"""Cloths and ropes of plain shape."""

from __future__ import annotations

import numpy as np

from orbit_core.scene import KeyPoint, Mesh


def sheet(size: tuple[float, float], counts: tuple[int, int]) -> Mesh:
    """A rectangle in the plane z = 0 around the origin, ``size`` (x, y) in metres, of particles in rows along x.

    Particle ``row * counts[0] + column`` is at the given column (along x) and row (along y). Diagonals alternate, so
    that the mesh is alike in all four directions.
    """
    columns, rows = counts
    x, y = (np.linspace(-0.5 * extent, 0.5 * extent, count) for extent, count in zip(size, counts, strict=True))
    vertices = np.stack((*np.meshgrid(x, y), np.zeros((rows, columns))), axis=-1).reshape(-1, 3)
    row, column = np.divmod(np.arange((rows - 1) * (columns - 1)), columns - 1)
    a = row * columns + column
    b, c, d = a + 1, a + columns, a + columns + 1
    rising = np.concatenate((np.stack((a, b, d), -1), np.stack((a, d, c), -1)))
    falling = np.concatenate((np.stack((a, b, c), -1), np.stack((b, d, c), -1)))
    even = np.tile((row + column) % 2 == 0, 2)[:, None]
    return Mesh(vertices, np.where(even, rising, falling))


def corners(counts: tuple[int, int]) -> tuple[KeyPoint, ...]:
    """Key points of a :func:`sheet`: its corners by the signs of x and y, the middles of its sides, and its middle."""
    columns, rows = counts
    last, top, half, middle = columns - 1, (rows - 1) * columns, (columns - 1) // 2, (rows - 1) // 2 * columns
    places = {
        "corner--": 0, "corner+-": last, "corner-+": top, "corner++": top + last,
        "side-": middle, "side+": middle + last, "front": half, "back": top + half, "middle": middle + half,
    }  # fmt: skip
    return tuple(KeyPoint(name, (particle,)) for name, particle in places.items())


def line(length: float, count: int) -> np.ndarray:
    """(count, 3) points along x, around the origin, for a rope of that length in metres."""
    points = np.zeros((count, 3))
    points[:, 0] = np.linspace(-0.5 * length, 0.5 * length, count)
    return points
