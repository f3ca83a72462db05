"""Forms of household things: convex pieces that collide and surfaces that are drawn, from a few numbers.

Each form stands with its lowest point at z = 0. Curved walls are split into wedges of exact convex shape instead of a
convex decomposition: 8 wedges of a mug's wall take a millisecond and enclose 4 % less than the true volume, where a
decomposition takes seconds and encloses more than it.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from itertools import pairwise

import numpy as np

from orbit_core.interfaces.errors import ConfigurationError
from orbit_core.scene import Box, Capsule, Cylinder, Geometry, Mesh, Pose, Sphere
from orbit_core.scene.pose import FloatArray, Vector3

# Wedges around a vessel's wall: radii are off by 4 % at most, and contact stays cheap.
_SECTORS = 8
# Corners around drawn surfaces, and around the hulls of solids of revolution.
_DRAWN, _HULL = 32, 16


@dataclass(frozen=True, eq=False)
class Piece:
    """A convex geometry at its place in the thing; ``color`` is None where it has the thing's own."""

    geometry: Geometry
    """Convex, so that every backend collides with it as it is."""
    pose: Pose = field(default_factory=Pose)
    """In the frame of the form, whose lowest point is at z = 0."""
    color: tuple[float, ...] | None = None


@dataclass(frozen=True, eq=False)
class Form:
    """Collision pieces and drawn surfaces of a thing."""

    collisions: tuple[Piece, ...]
    """Convex pieces that collide."""
    visuals: tuple[Piece, ...]
    """Surfaces that are drawn, with more corners where they are round."""
    cavity: Cavity | None = None
    """The space inside of a vessel that is open at the top."""


@dataclass(frozen=True)
class Cavity:
    """An upright round space that is open at the top."""

    axis: tuple[float, float]
    """Its x and y, m."""
    profile: tuple[tuple[float, float], ...]
    """Rows of [height, radius] of its wall, from its floor to its rim, m."""

    @property
    def floor(self) -> float:
        """Height of its floor, m."""
        return self.profile[0][0]

    @property
    def rim(self) -> float:
        """Height of its rim, m."""
        return self.profile[-1][0]

    def lift(self, radius: float) -> float | None:
        """Return the height above its floor from which a disc of that radius on its axis fits; None where none does."""
        for (z0, r0), (z1, r1) in pairwise(self.profile):
            if radius <= r0:
                return z0 - self.floor
            if radius <= r1:
                return z0 + (radius - r0) / (r1 - r0) * (z1 - z0) - self.floor
        return None


@dataclass(frozen=True, kw_only=True)
class Vessel:
    """A vessel turned about z, open at the top."""

    profile: tuple[tuple[float, ...], ...]
    """Rows of [radius, height] of the outside, from the bottom up, m."""
    wall: float
    """Thickness of the wall, m."""
    floor: float
    """Thickness of the floor, m."""
    loops: tuple[tuple[float, ...], ...] = ()
    """Handles, each [angle about z, reach from the wall, lower height, upper height], rad and m."""
    stick: tuple[float, ...] = ()
    """A straight handle along x at the rim: [length, height], m."""
    stem: tuple[tuple[float, ...], ...] = ()
    """Profile of a solid below the vessel."""


@dataclass(frozen=True, kw_only=True)
class Part:
    """A convex part of a thing; exactly one of its geometries is given."""

    box: tuple[float, ...] = ()
    """Full size, m."""
    cylinder: tuple[float, ...] = ()
    """Diameter and length, m."""
    capsule: tuple[float, ...] = ()
    """Radius and length between the centres of its caps, m."""
    round: tuple[float, ...] = ()
    """Full size of an ellipsoid, m."""
    at: tuple[float, ...] = (0.0, 0.0, 0.0)
    """Middle, m."""
    along: tuple[float, ...] = ()
    """Direction of a cylinder's or a capsule's axis; up where it is left out."""
    tilt: float = 0.0
    """Rotation about y, rad."""
    color: tuple[float, ...] = ()
    """RGB or RGBA, 0 to 1; the thing's own where it is left out."""


def vector(values: Sequence[float], what: str) -> Vector3:
    """Return three numbers of a file as a vector.

    Raises:
        ConfigurationError: there are more or fewer, or one is not finite.
    """
    if len(values) != 3 or not all(math.isfinite(value) for value in values):
        raise ConfigurationError(f"{what} is {tuple(values)}: give three finite numbers")
    return (float(values[0]), float(values[1]), float(values[2]))


def block(size: Sequence[float]) -> Form:
    """Build a box of full ``size`` in metres."""
    x, y, z = vector(size, "the size of a block")
    return _solid(Piece(Box((x / 2, y / 2, z / 2)), Pose((0.0, 0.0, z / 2))))


def can(diameter: float, height: float) -> Form:
    """Build an upright cylinder."""
    return _solid(Piece(Cylinder(diameter / 2, height / 2), Pose((0.0, 0.0, height / 2))))


def rounded(size: Sequence[float]) -> Form:
    """Build an ellipsoid of full ``size`` in metres; a ball where the three are equal."""
    z = vector(size, "the size of an ellipsoid")[2]
    place = Pose((0.0, 0.0, z / 2))
    collision, visual = (_ellipsoid(size, corners) for corners in (_HULL, _DRAWN))
    return Form((Piece(collision, place),), (Piece(visual, place),))


def turned(profile: Sequence[Sequence[float]]) -> Form:
    """Build a solid of revolution about z; its pieces are the convex stretches of the profile."""
    pieces = tuple(Piece(_turned(stretch, _HULL)) for stretch in _convex_stretches(profile))
    return Form(pieces, (Piece(_turned(profile, _DRAWN)),))


def vessel(spec: Vessel) -> Form:
    """Build a vessel of wedges around a floor, with its handles."""
    rows = [(float(r), float(z)) for r, z in spec.profile]
    pieces = [Piece(_floor(rows, spec.floor))]
    for (r0, z0), (r1, z1) in pairwise(rows):
        # The lowest wedges stand on the vessel's own underside, so that only they and the floor touch the table.
        wedge = _wedge((r0, z0), (r1, z1), spec.wall)
        turns = (2.0 * math.pi * index / _SECTORS for index in range(_SECTORS))
        pieces += [Piece(wedge, Pose.from_euler(0.0, 0.0, turn)) for turn in turns]
    handles = [*(piece for loop in spec.loops for piece in _loop(rows, loop)), *_stick(rows, spec.stick)]
    stem = turned(spec.stem) if spec.stem else Form((), ())
    hollow = Piece(_hollow(rows, spec.wall, spec.floor))
    ground = rows[0][1] + spec.floor
    radius = float(np.interp(ground, [z for _, z in rows], [r for r, _ in rows]))
    inside = [(z, r - spec.wall) for r, z in rows if z > ground + 1e-6]
    cavity = Cavity((0.0, 0.0), ((ground, radius - spec.wall), *inside))
    return Form((*pieces, *handles, *stem.collisions), (hollow, *handles, *stem.visuals), cavity)


def assembled(parts: Sequence[Part]) -> Form:
    """Build a thing of convex parts.

    Raises:
        ConfigurationError: a part has no geometry, or two.
    """
    collisions = tuple(_part(part, _HULL) for part in parts)
    return Form(collisions, tuple(_part(part, _DRAWN) for part in parts))


def _part(part: Part, corners: int) -> Piece:
    given = [name for name in ("box", "cylinder", "capsule", "round") if getattr(part, name)]
    if len(given) != 1:
        raise ConfigurationError(f"a part has {' and '.join(given) or 'no geometry'}: give one of box, cylinder, ...")
    match given[0]:
        case "box":
            x, y, z = vector(part.box, "the size of a box")
            geometry: Geometry = Box((x / 2, y / 2, z / 2))
        case "cylinder":
            geometry = Cylinder(part.cylinder[0] / 2, part.cylinder[1] / 2)
        case "capsule":
            geometry = Capsule(part.capsule[0], part.capsule[1] / 2)
        case _:
            geometry = _ellipsoid(part.round, corners)
    place = Pose(vector(part.at, "the place of a part"))
    if part.along:
        place = place @ _upright_to(np.asarray(vector(part.along, "the axis of a part")))
    return Piece(geometry, place @ Pose.from_euler(0.0, part.tilt, 0.0), part.color or None)


def _solid(piece: Piece) -> Form:
    return Form((piece,), (piece,))


def _upright_to(axis: FloatArray) -> Pose:
    """Return the rotation that takes z to an axis."""
    axis = axis / np.linalg.norm(axis)
    turn = np.cross((0.0, 0.0, 1.0), axis)
    sine = float(np.linalg.norm(turn))
    if sine < 1e-9:
        return Pose()
    x, y, z = (float(value) for value in turn)
    return Pose.from_axis_angle((x, y, z), math.atan2(sine, float(axis[2])))


def _ellipsoid(size: Sequence[float], corners: int) -> Geometry:
    x, y, z = vector(size, "the size of an ellipsoid")
    if x == y == z:
        return Sphere(x / 2)
    angles = np.linspace(-math.pi / 2, math.pi / 2, corners // 2 + 1)
    ball = _turned([(math.cos(angle), math.sin(angle)) for angle in angles], corners)
    return Mesh((np.asarray(ball.vertices) * (x / 2, y / 2, z / 2)).astype(np.float32), ball.faces)


def _turned(profile: Sequence[Sequence[float]], corners: int) -> Mesh:
    """Return the closed surface of a profile of [radius, height], from the bottom up, turned about z."""
    rows = [(float(r), float(z)) for r, z in profile]
    # Rows on the axis would be rings of no size; both ends are closed by a point there.
    rings = [row for row in rows if row[0] > 1e-6]
    angles = np.arange(corners) * (2.0 * math.pi / corners)
    around = np.stack((np.cos(angles), np.sin(angles)), 1)
    points = [np.column_stack((radius * around, np.full(corners, height))) for radius, height in rings]
    points += [np.array([[0.0, 0.0, rows[0][1]], [0.0, 0.0, rows[-1][1]]])]
    first, last = len(rings) * corners, len(rings) * corners + 1
    here = np.arange(corners)
    there = (here + 1) % corners
    faces = [np.stack((np.full(corners, first), there, here), 1)]
    for ring in range(len(rings) - 1):
        low, high = ring * corners, (ring + 1) * corners
        faces += [np.stack((low + here, low + there, high + there), 1)]
        faces += [np.stack((low + here, high + there, high + here), 1)]
    top = (len(rings) - 1) * corners
    faces += [np.stack((np.full(corners, last), top + here, top + there), 1)]
    return _mesh(np.concatenate(points), np.concatenate(faces))


def _hollow(rows: list[tuple[float, float]], wall: float, floor: float) -> Mesh:
    """Return the closed surface of a vessel: up its outside, over the rim, and down its inside to the floor."""
    inside = [(max(r - wall, 1e-3), z) for r, z in rows[1:]]
    ground = rows[0][1] + floor
    # Where the outside widens within the floor's thickness, the inside begins on the floor.
    inside = [(r, z) for r, z in inside if z > ground + 1e-6]
    below = max(rows[0][0] - wall, 2e-3)
    return _turned([*rows, *reversed(inside), (below, ground), (0.0, ground)], _DRAWN)


def _floor(rows: list[tuple[float, float]], thickness: float) -> Mesh:
    """Return the convex plate at the bottom of a vessel, as wide as its outside there."""
    (r0, z0), (r1, z1) = rows[0], rows[1]
    # The floor widens with the wall as far as it is thick.
    share = min(thickness / (z1 - z0), 1.0)
    return _turned([(r0, z0), (r0 + share * (r1 - r0), z0 + thickness)], _SECTORS)


def _wedge(low: tuple[float, float], high: tuple[float, float], wall: float) -> Mesh:
    """Return one sector of a wall between two rings of the outside, as a convex solid of eight corners."""
    half = math.pi / _SECTORS
    # Corners outside and sides inside of the true circle by the same 4 %.
    out = 2.0 / (1.0 + math.cos(half))
    rings = [(max(low[0] - wall, 1e-3), low[1]), low, (max(high[0] - wall, 1e-3), high[1]), high]
    corners = [
        (out * radius * math.cos(angle), out * radius * math.sin(angle), height)
        for angle in (-half, half)
        for radius, height in rings
    ]
    # Corners 0 to 3 at one side: inner low, outer low, inner high, outer high; 4 to 7 at the other.
    # All six sides are plane: inner and outer ones are trapezia between two chords.
    quads = ((0, 2, 3, 1), (4, 5, 7, 6), (0, 4, 6, 2), (1, 3, 7, 5), (0, 1, 5, 4), (2, 6, 7, 3))
    faces = [triangle for a, b, c, d in quads for triangle in ((a, c, b), (a, d, c))]
    return _outward(np.array(corners), np.array(faces))


def _outward(points: FloatArray, faces: np.ndarray) -> Mesh:
    """Return a convex mesh with every triangle facing away from its middle."""
    a, b, c = (points[faces[:, corner]] for corner in range(3))
    inward = np.einsum("ij,ij->i", np.cross(b - a, c - a), a - points.mean(0)) < 0.0
    return _mesh(points, np.where(inward[:, None], faces[:, ::-1], faces))


def _loop(rows: list[tuple[float, float]], loop: Sequence[float]) -> Iterator[Piece]:
    """Yield the three bars of a handle: out of the wall, down, and back."""
    angle, reach, low, high = loop
    turn = Pose.from_euler(0.0, 0.0, angle)
    # A finger fits through, and three bars never meet.
    thick = min(0.010, (high - low) / 3.0)
    radii = [float(np.interp(height, [z for _, z in rows], [r for r, _ in rows])) for height in (low, high)]
    out = max(radii) + reach
    for height, radius in zip((low + thick / 2, high - thick / 2), radii, strict=True):
        # A little into the wall, so that no gap opens between wedge and bar.
        start = radius * math.cos(math.pi / _SECTORS) - 0.001
        bar = Box(((out - start) / 2, thick / 2, thick / 2))
        yield Piece(bar, turn @ Pose(((out + start) / 2, 0.0, height)))
    upright = Box((thick / 2, thick / 2, (high - low) / 2))
    yield Piece(upright, turn @ Pose((out - thick / 2, 0.0, (low + high) / 2)))


def _stick(rows: list[tuple[float, float]], stick: Sequence[float]) -> Iterator[Piece]:
    """Yield the straight handle of a pan."""
    if stick:
        length, height = stick
        radius = float(np.interp(height, [z for _, z in rows], [r for r, _ in rows]))
        start = radius * math.cos(math.pi / _SECTORS) - 0.002
        yield Piece(Box((length / 2, 0.012, 0.006)), Pose((start + length / 2, 0.0, height)))


def _convex_stretches(profile: Sequence[Sequence[float]]) -> Iterator[list[Sequence[float]]]:
    """Split a profile where its outline turns inward, or it jumps outward at one height."""
    rows = list(profile)
    stretch = [rows[0]]
    for row in rows[1:]:
        if len(stretch) > 1:
            (r0, z0), (r1, z1), (r2, z2) = stretch[-2], stretch[-1], row
            # Going up, a convex outline bends towards the axis: the cross product of successive sides is positive.
            if (r1 - r0) * (z2 - z1) - (z1 - z0) * (r2 - r1) < -1e-12:
                yield stretch
                stretch = [stretch[-1]]
        stretch.append(row)
    yield stretch


def _mesh(points: FloatArray, faces: np.ndarray) -> Mesh:
    return Mesh(np.ascontiguousarray(points, dtype=np.float32), np.ascontiguousarray(faces, dtype=np.int32))
