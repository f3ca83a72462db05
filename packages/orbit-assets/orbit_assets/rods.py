"""Bent rods on two stands, and rings on a handle that go along them, both of capsules.

Every engine has capsules as they are, so that a ring touches its rod at the same distance on each.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from orbit_assets.objects import DENSITY, solid_link
from orbit_core.interfaces.errors import AssetError
from orbit_core.scene import Articulation, Capsule, Color, Frame, ObjectSpec, Pose, Shape
from orbit_core.scene.pose import Vector3

# Points to a piece of a spline, between which it is taken as straight.
_FINE = 100
_STEEL: Color = (0.72, 0.74, 0.78, 1.0)
_BRASS: Color = (0.85, 0.62, 0.2, 1.0)


@dataclass(frozen=True, eq=False)
class Course:
    """Points (K, 3) in metres, equally far apart along a curve, and the curve's unit tangents (K, 3) there."""

    points: npt.NDArray[np.float64]
    tangents: npt.NDArray[np.float64]
    spacing: float
    """Metres along the curve from a point to the next."""

    def part(self, margin: float) -> Course:
        """Return the course without ``margin`` metres at either end, to the next point."""
        cut = round(margin / self.spacing)
        return Course(
            self.points[cut : len(self.points) - cut], self.tangents[cut : len(self.points) - cut], self.spacing
        )


def spline(corners: Sequence[Vector3], spacing: float) -> Course:
    """Return the curve through all ``corners``, in metres, with points about ``spacing`` apart.

    A Catmull-Rom spline (A Class of Local Interpolating Splines, 1974), whose end pieces take the corner beyond the end
    in line with the last two.

    Raises:
        AssetError: there are fewer than two corners, or two that follow each other are the same.
    """
    given = np.asarray(corners, dtype=np.float64).reshape(-1, 3)
    if len(given) < 2 or (np.linalg.norm(np.diff(given, axis=0), axis=1) == 0.0).any():
        raise AssetError(
            "a rod is bent through two corners or more, of which no two that follow each other are the same"
        )
    # A spline of this kind needs a corner before the first and one after the last.
    ends = 2.0 * given[0] - given[1], 2.0 * given[-1] - given[-2]
    padded = np.concatenate((ends[:1], given, ends[1:]))
    u = np.linspace(0.0, 1.0, _FINE, endpoint=False)[:, None]
    pieces = [_piece(padded[index : index + 4], u) for index in range(len(given) - 1)]
    fine = np.concatenate((*pieces, given[-1:]))
    # Equal steps of the spline's parameter are no equal lengths: the points are placed by arc length.
    along = np.concatenate(([0.0], np.linalg.norm(np.diff(fine, axis=0), axis=1).cumsum()))
    places = np.linspace(0.0, along[-1], max(2, round(along[-1] / spacing) + 1))
    points = np.stack([np.interp(places, along, column) for column in fine.T], 1)
    ways = np.gradient(points, axis=0)
    return Course(points, ways / np.linalg.norm(ways, axis=1, keepdims=True), float(places[1]))


def bent_rod(name: str, course: Course, radius: float, every: int, pose: Pose) -> ObjectSpec:
    """Return a fixed rod along a course, with a capsule to every so many points, on two stands.

    The object's frame is the course's; its stands go down to the plane z = 0 of the frame that ``pose`` is in.
    """
    knots = course.points[np.unique(np.append(np.arange(0, len(course.points), every), len(course.points) - 1))]
    # Stands are capsules as well: every engine collides them exactly.
    feet = [(*end[:2], -pose.position[2]) for end in (knots[0], knots[-1])]
    lines = [*itertools.pairwise(knots), (knots[0], feet[0]), (knots[-1], feet[1])]
    shapes = tuple(_line(start, end, radius, _STEEL) for start, end in lines)
    articulation = Articulation(name, (solid_link(name, shapes, DENSITY),))
    return ObjectSpec(name=name, articulation=articulation, pose=pose, fixed_base=True, semantic_label="rod")


def ring_on_handle(name: str, radius: float, thickness: float, reach: float, pieces: int = 20) -> Articulation:
    """Return a ring in the xz plane, whose middle, the frame ``NAME_middle``, is ``reach`` along z from the handle's
    end.

    Args:
        name: of its one link.
        radius: metres from the middle to the ring's own middle line.
        thickness: metres, radius of its bars.
        reach: metres from the link's frame, where the handle ends, to the ring's middle.
        pieces: capsules around the ring.

    Raises:
        AssetError: the bars fill the ring, or the handle ends within it.
    """
    if not 0.0 < thickness < radius < reach:
        raise AssetError(
            f"ring '{name}' needs bars thinner than its radius and a handle that is longer, not {thickness:g} m, "
            f"{radius:g} m and {reach:g} m"
        )
    angles = 2.0 * math.pi * np.arange(pieces + 1) / pieces
    around = np.stack((radius * np.sin(angles), np.zeros_like(angles), reach - radius * np.cos(angles)), 1)
    lines = [*itertools.pairwise(around), (np.zeros(3), around[0])]
    shapes = tuple(_line(start, end, thickness, _BRASS) for start, end in lines)
    frame = Frame(f"{name}_middle", name, Pose((0.0, 0.0, reach)))
    return Articulation(name, (solid_link(name, shapes, DENSITY),), frames=(frame,))


def _piece(corners: npt.NDArray[np.float64], u: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
    """Return points between the second and the third of four corners."""
    a, b, c, d = corners
    return 0.5 * (2.0 * b + (c - a) * u + (2.0 * a - 5.0 * b + 4.0 * c - d) * u**2 + (3.0 * (b - c) + d - a) * u**3)


def _line(start: npt.ArrayLike, end: npt.ArrayLike, radius: float, color: Color) -> Shape:
    """Return a capsule from one point to another."""
    first, last = np.asarray(start, dtype=np.float64), np.asarray(end, dtype=np.float64)
    way = last - first
    length = float(np.linalg.norm(way))
    x, y, z = way / length
    across = math.hypot(x, y)
    # A vertical line has no turn about a horizontal axis: any axis serves.
    axis = (-y / across, x / across, 0.0) if across > 1e-9 else (1.0, 0.0, 0.0)
    px, py, pz = (0.5 * (first + last)).tolist()
    pose = Pose.from_axis_angle(axis, math.atan2(across, z), (px, py, pz))
    return Shape(Capsule(radius, 0.5 * length), pose, color=color)
