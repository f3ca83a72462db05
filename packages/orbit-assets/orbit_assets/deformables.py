"""Cloths and ropes of plain shape."""

from __future__ import annotations

import math
from collections.abc import Sequence
from numbers import Integral

import numpy as np

from orbit_core.interfaces.errors import ArgumentError
from orbit_core.scene import Articulation, Box, KeyPoint, Link, Mesh, ObjectSpec, PhysicsMaterial, Pose, Shape
from orbit_core.scene.pose import Vector3


def sheet(size: tuple[float, float], counts: tuple[int, int]) -> Mesh:
    """Build a rectangle in the plane z = 0 around the origin, ``size`` (x, y) in metres, of particles in rows along x.

    Particle ``row * counts[0] + column`` is at the given column (along x) and row (along y). Diagonals alternate, so
    that the mesh is alike in all four directions.

    Raises:
        ArgumentError: a length is not above 0 m, or a count not a whole number of two or more.
    """
    _check("a sheet", size, counts)
    columns, rows = counts
    x, y = (np.linspace(-0.5 * extent, 0.5 * extent, count) for extent, count in zip(size, counts, strict=True))
    vertices = np.stack((*np.meshgrid(x, y), np.zeros((rows, columns))), axis=-1).reshape(-1, 3)
    row, column = np.divmod(np.arange((rows - 1) * (columns - 1)), columns - 1)
    a = row * columns + column
    # Corners of each square: a and b in one row, c and d in the next.
    b, c, d = a + 1, a + columns, a + columns + 1
    rising = np.concatenate((np.stack((a, b, d), -1), np.stack((a, d, c), -1)))
    falling = np.concatenate((np.stack((a, b, c), -1), np.stack((b, d, c), -1)))
    # Diagonals of one direction would make the sheet stiffer along them.
    even = np.tile((row + column) % 2 == 0, 2)[:, None]
    return Mesh(vertices, np.where(even, rising, falling))


def corners(counts: tuple[int, int]) -> tuple[KeyPoint, ...]:
    """Return the key points of a :func:`sheet`: corners by the signs of x and y, middles of sides, and the middle."""
    columns, rows = counts
    last, top, half, middle = columns - 1, (rows - 1) * columns, (columns - 1) // 2, (rows - 1) // 2 * columns
    places = {
        "corner--": 0, "corner+-": last, "corner-+": top, "corner++": top + last,
        "side-": middle, "side+": middle + last, "front": half, "back": top + half, "middle": middle + half,
    }  # fmt: skip
    return tuple(KeyPoint(name, (particle,)) for name, particle in places.items())


def line(length: float, count: int) -> np.ndarray:
    """Return points (count, 3) along x, around the origin, for a rope of that length in metres.

    Raises:
        ArgumentError: the length is not above 0 m, or the count not a whole number of two or more.
    """
    _check("a line", (length,), (count,))
    points = np.zeros((count, 3))
    points[:, 0] = np.linspace(-0.5 * length, 0.5 * length, count)
    return points


def _check(what: str, lengths: Sequence[float], counts: Sequence[int]) -> None:
    for length in lengths:
        if not 0.0 < length < math.inf:
            raise ArgumentError(f"{what} is {length} m long or wide: give more than 0")
    for count in counts:
        if not isinstance(count, Integral) or count < 2:
            raise ArgumentError(f"{what} has {count} particles along a side: give a whole number of two or more")


def open_box(
    name: str, inner: Vector3, pose: Pose, *, wall: float = 0.01, material: PhysicsMaterial | None = None
) -> ObjectSpec:
    """Build a fixed container, open at the top: ``inner`` (x, y, z) metres within its walls; its frame on the floor
    inside.
    """
    x, y, z = (0.5 * extent for extent in inner)
    half, surface, color = 0.5 * wall, material or PhysicsMaterial(), (0.35, 0.5, 0.7, 1.0)
    parts = {
        "floor": ((x + wall, y + wall, half), (0.0, 0.0, -half)),
        "left": ((x + wall, half, z), (0.0, y + half, z)),
        "right": ((x + wall, half, z), (0.0, -y - half, z)),
        "front": ((half, y, z), (x + half, 0.0, z)),
        "back": ((half, y, z), (-x - half, 0.0, z)),
    }
    shapes = tuple(Shape(Box(size), Pose(at), surface, color, part) for part, (size, at) in parts.items())
    # The container is fixed: its mass is required and without effect.
    link = Link(name, 1.0, (0.0, 0.0, 0.0), 0.01 * np.eye(3), shapes, shapes)
    return ObjectSpec(
        name=name, articulation=Articulation(name, (link,)), fixed_base=True, pose=pose, semantic_label=name
    )
