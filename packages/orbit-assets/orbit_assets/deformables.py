"""Cloths, ropes and soft bodies of plain shape."""

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


def cuboid(size: Vector3, counts: tuple[int, int, int] = (2, 2, 2)) -> Mesh:
    """Return the closed surface of a box around the origin, for a soft body.

    Args:
        size: edges along x, y and z, in metres.
        counts: squares along each edge, of two triangles each.

    Raises:
        ArgumentError: a length is not above 0 m, or a count not a whole number of one or more.
    """
    _check("a cuboid", size, [count + 1 if isinstance(count, Integral) else count for count in counts])
    lattice = np.stack(np.meshgrid(*(np.arange(count + 1) for count in counts), indexing="ij"), axis=-1)
    numbers = np.arange(lattice[..., 0].size).reshape(lattice.shape[:3])
    faces = []
    for axis in range(3):
        for side in (0, -1):
            face = np.take(numbers, side, axis=axis)
            a, b, c, d = face[:-1, :-1], face[1:, :-1], face[1:, 1:], face[:-1, 1:]
            squares = np.stack((np.stack((a, b, c), -1), np.stack((a, c, d), -1))).reshape(-1, 3)
            # Seen along y, the two other axes come in the other order.
            inwards = (side == 0) != (axis == 1)
            faces.append(squares[:, ::-1] if inwards else squares)
    triangles = np.concatenate(faces)
    used, triangles = np.unique(triangles, return_inverse=True)
    vertices = (lattice.reshape(-1, 3)[used] / np.array(counts) - 0.5) * np.array(size)
    return Mesh(vertices, triangles.reshape(-1, 3))


def ball(radius: float, divisions: int = 3) -> Mesh:
    """Return the closed surface of a ball around the origin, for a soft body: a divided icosahedron.

    Args:
        radius: in metres, of the vertices.
        divisions: how often each triangle is divided into four.

    Raises:
        ArgumentError: the radius is not above 0 m, or there are no or more than 6 divisions.
    """
    _check("a ball", (radius,), ())
    if not isinstance(divisions, Integral) or not 1 <= divisions <= 6:
        raise ArgumentError(f"a ball is divided {divisions} times: give 1 to 6")
    import trimesh

    solid = trimesh.creation.icosphere(subdivisions=int(divisions), radius=radius)
    return Mesh(np.asarray(solid.vertices, np.float64), np.asarray(solid.faces, np.int64))


def ring(radius: float, thickness: float, counts: tuple[int, int] = (24, 12)) -> Mesh:
    """Return the closed surface of a ring that lies around the z axis, for a soft body.

    Args:
        radius: of the circle in its middle, in metres.
        thickness: radius of its section, in metres.
        counts: squares around the axis, and around the section.

    Raises:
        ArgumentError: the section is as wide as the circle, a length is not above 0 m, or a count is below 3.
    """
    _check("a ring", (radius, thickness), [count - 1 if isinstance(count, Integral) else count for count in counts])
    if thickness >= radius:
        raise ArgumentError(f"a ring of radius {radius} m has no hole with a section of {thickness} m: give it less")
    u, v = (2.0 * math.pi * np.arange(count) / count for count in counts)
    out = radius + thickness * np.cos(v)
    vertices = np.stack(
        (np.cos(u)[:, None] * out, np.sin(u)[:, None] * out, np.broadcast_to(thickness * np.sin(v), (len(u), len(v)))),
        axis=-1,
    ).reshape(-1, 3)
    i, j = np.divmod(np.arange(len(vertices)), counts[1])
    after, above = (i + 1) % counts[0] * counts[1], (j + 1) % counts[1]
    here = i * counts[1]
    a, b, c, d = here + j, after + j, after + above, here + above
    return Mesh(vertices, np.concatenate((np.stack((a, b, c), -1), np.stack((a, c, d), -1))))


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
