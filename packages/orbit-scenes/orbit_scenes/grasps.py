"""Grasp candidates of things for a parallel gripper, by the shape of their convex pieces, checked against all others.

A candidate closes the fingers on two opposite sides of one piece: the sides of a box, the mantle of a round piece, the
inside and outside of a vessel's wall at its rim. It is kept where two finger pads fit around the piece without entering
any piece of the thing.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from orbit_assets.decomposition import Convex, convex_shape, within
from orbit_core.interfaces.errors import ArgumentError
from orbit_core.scene import Box, Capsule, Cylinder, Link, Mesh, Pose, Shape, Sphere
from orbit_core.scene.pose import FloatArray
from orbit_scenes.things import Thing


@dataclass(frozen=True, kw_only=True)
class Jaw:
    """A parallel gripper by its sizes; the defaults are those of a Franka hand.

    Raises:
        ArgumentError: a length is not above zero.
    """

    opening: float = 0.08
    """Most metres between the pads."""
    pad: tuple[float, float, float] = (0.018, 0.012, 0.054)
    """Width, thickness and length of a finger, m."""
    clearance: float = 0.002
    """Metres between an open pad and the thing."""

    def __post_init__(self) -> None:
        for length in (self.opening, *self.pad, self.clearance):
            if not 0.0 < length < math.inf:
                raise ArgumentError(f"a length of a jaw is {length}: give metres above zero")


@dataclass(frozen=True)
class Grasp:
    """One candidate, in the frame of the thing's link."""

    pose: Pose
    """Of the end effector between the fingertips: z along the approach, y from one finger to the other."""
    width: float
    """Metres between the pads when they touch."""
    piece: str
    """Name of the shape that is held."""


def grasps(thing: Thing | Link, jaw: Jaw = Jaw()) -> tuple[Grasp, ...]:
    """Return the grasp candidates of a thing, those near its centre of mass first.

    Args:
        thing: of the library, or a link with convex collision shapes.
        jaw: the gripper; what is wider than its opening has none.
    """
    # A link of a file or of a set serves as well, as long as its shapes are convex.
    link = thing.link if isinstance(thing, Thing) else thing
    solids = [(shape, convex_shape(shape, Pose())) for shape in link.collisions]
    pieces = [(shape, convex) for shape, convex in solids if convex is not None]
    found = [
        Grasp(pose, width, shape.name)
        for shape, _ in pieces
        for pose, width in _around(shape)
        if width <= jaw.opening - 2.0 * jaw.clearance and _fits(pose, width, [each for _, each in pieces], jaw)
    ]
    center = np.asarray(link.center_of_mass)
    return tuple(sorted(found, key=lambda grasp: float(np.linalg.norm(np.asarray(grasp.pose.position) - center))))


def _around(shape: Shape) -> Iterator[tuple[Pose, float]]:
    """Yield poses in the link's frame that close on two sides of a piece, with the width between them."""
    match shape.geometry:
        case Box(half_extents=half):
            yield from _box(shape.pose, np.eye(3), np.asarray(half), np.zeros(3))
        case Sphere(radius=radius):
            yield from _round(shape.pose, radius, 0.0)
        case Cylinder(radius=radius, half_length=half) | Capsule(radius=radius, half_length=half):
            yield from _round(shape.pose, radius, half)
        case Mesh(vertices=vertices) if len(vertices) == 8:
            yield from _wedge(shape.pose, np.asarray(vertices, dtype=float))
        case Mesh(vertices=vertices):
            yield from _hull(shape.pose, np.asarray(vertices, dtype=float))
        case _:
            return


def _box(place: Pose, axes: FloatArray, half: FloatArray, middle: FloatArray) -> Iterator[tuple[Pose, float]]:
    """Yield grasps across each axis of a box, from both directions of the other two, at three places along each."""
    for across in range(3):
        for approach in (axis for axis in range(3) if axis != across):
            along = 3 - across - approach
            for sign in (1.0, -1.0):
                for share in (0.0, 0.5, -0.5):
                    # The pads reach the middle, or 20 mm in from the near side of a large box.
                    depth = max(0.0, half[approach] - 0.02)
                    spot = middle + share * half[along] * axes[along] - sign * depth * axes[approach]
                    yield place @ _facing(spot, sign * axes[approach], axes[across]), 2.0 * float(half[across])


def _round(place: Pose, radius: float, half: float) -> Iterator[tuple[Pose, float]]:
    """Yield grasps across a round piece along z: from its sides, and from both ends."""
    for angle in np.arange(8) * (math.pi / 4):
        out = np.array((math.cos(angle), math.sin(angle), 0.0))
        side = np.array((-math.sin(angle), math.cos(angle), 0.0))
        for height in {0.0, 0.5 * half, -0.5 * half}:
            yield place @ _facing(np.array((0.0, 0.0, height)), -out, side), 2.0 * radius
        if half > 0.0:
            # Across its ends, as a flat tin is held from its side.
            rim = max(0.0, radius - 0.02) * out
            yield place @ _facing(rim, -out, np.array((0.0, 0.0, 1.0))), 2.0 * half
        for sign in (1.0, -1.0):
            end = np.array((0.0, 0.0, sign * max(0.0, half - 0.02)))
            yield place @ _facing(end, np.array((0.0, 0.0, -sign)), side), 2.0 * radius


def _wedge(place: Pose, corners: FloatArray) -> Iterator[tuple[Pose, float]]:
    """Yield the grasp of a wall's wedge at its upper end, along the wall, with one pad inside."""
    upper = corners[:, 2] > corners[:, 2].mean()
    top, bottom = corners[upper], corners[~upper]
    down = bottom.mean(0) - top.mean(0)
    down /= np.linalg.norm(down)
    out = np.array((*top[:, :2].mean(0), 0.0))
    out -= (out @ down) * down
    out /= np.linalg.norm(out)
    yield place @ _facing(top.mean(0) + 0.012 * down, down, out), float(np.ptp(top @ out))


def _hull(place: Pose, points: FloatArray) -> Iterator[tuple[Pose, float]]:
    """Yield grasps across the bounding box of a convex piece, and around it where it is turned about z."""
    low, high = points.min(0), points.max(0)
    middle, half = (low + high) / 2, (high - low) / 2
    yield from _box(place, np.eye(3), half, middle)
    if math.isclose(half[0], half[1], rel_tol=0.05):
        yield from _round(place @ Pose(tuple(middle)), float(max(half[:2])), float(half[2]))


def _facing(spot: FloatArray, approach: FloatArray, across: FloatArray) -> Pose:
    """Return the pose at a spot with z along the approach and y across."""
    rotation = np.stack((np.cross(across, approach), across, approach), axis=1)
    return Pose(tuple(spot), Pose.from_matrix(rotation).orientation)


def _fits(pose: Pose, width: float, pieces: list[Convex], jaw: Jaw) -> bool:
    """Return True if two open pads on either side, and the palm behind them, enter no piece."""
    x, y, z = (length / 2 for length in jaw.pad)
    # The tips reach 8 mm beyond the line between the contacts.
    tip = 0.008
    palm = Box((x, jaw.opening / 2 + 2.0 * y, 0.01))
    solids = [(palm, (0.0, 0.0, tip - 2.0 * z - 0.01))]
    solids += [(Box((x, y, z)), (0.0, side * (width / 2 + jaw.clearance + y), tip - z)) for side in (1.0, -1.0)]
    for geometry, place in solids:
        own = convex_shape(Shape(geometry, Pose(place)), pose)
        assert own is not None  # a box is convex
        if any(within(own, piece, 1e-4) for piece in pieces):
            return False
    return True
