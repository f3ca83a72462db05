"""Distances between convex shapes, by the algorithm of Gilbert, Johnson and Keerthi.

Gilbert, Johnson and Keerthi, A fast procedure for computing the distance between complex objects in three-dimensional
space, IEEE Journal on Robotics and Automation, 1988. The nearest point of a simplex is found among all its faces
(Johnson's subalgorithm).
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np

from orbit_core.interfaces.layout import home_positions
from orbit_core.preparation.merge import merge_fixed_links
from orbit_core.preparation.validation import link_poses
from orbit_core.scene import Articulation, Box, Capsule, Cylinder, Entity, Mesh, Pose, Shape, Sphere
from orbit_core.scene.pose import FloatArray

# GJK converges in fewer than ten rounds on the shapes of robots; this bound stops numerical cycles.
_ROUNDS = 64
# Metres below which a distance counts as none, and to which distances are found.
_EXACT = 1e-9


@dataclass(frozen=True, eq=False)
class Convex:
    """The points within ``radius`` of a convex core.

    The core is the hull of ``points`` (P, 3), each the centre of a disc with the normal ``axis`` and the radius
    ``disc`` where that is not zero. A ball's core is a point, a capsule's two, a cylinder's two discs.
    """

    points: FloatArray
    radius: float = 0.0
    disc: float = 0.0
    axis: FloatArray | None = None

    def bounds(self) -> tuple[FloatArray, FloatArray]:
        """Return the least and the greatest corner (3,) of the box along the axes that holds the shape."""
        reach = np.full(3, self.radius)
        if self.axis is not None:
            # Support of a disc along each axis: its radius times the sine of the angle to its normal.
            reach = reach + self.disc * np.sqrt(np.clip(1.0 - np.square(self.axis), 0.0, 1.0))
        return self.points.min(0) - reach, self.points.max(0) + reach

    def support(self, direction: FloatArray) -> FloatArray:
        """Return the point (3,) of the core that is farthest along ``direction``."""
        farthest = self.points[int(np.argmax(self.points @ direction))]
        if self.axis is None:
            return farthest
        across = direction - (direction @ self.axis) * self.axis
        length = float(np.linalg.norm(across))
        return farthest + (self.disc / length) * across if length > 0.0 else farthest


def convex_shape(shape: Shape, place: Pose) -> Convex | None:
    """Return the shape of a link at ``place``, a mesh as its hull; ``None`` for ground and terrain."""
    pose = place @ shape.pose
    match shape.geometry:
        case Box(half_extents=half):
            corners = np.array(np.meshgrid(*([-1.0, 1.0],) * 3)).reshape(3, -1).T * half
            return Convex(pose.transform(corners))
        case Sphere(radius=radius):
            return Convex(pose.transform(np.zeros((1, 3))), radius)
        case Capsule(radius=radius, half_length=half):
            return Convex(pose.transform(_ends(half)), radius)
        case Cylinder(radius=radius, half_length=half):
            return Convex(pose.transform(_ends(half)), disc=radius, axis=pose.rotation_matrix()[:, 2])
        case Mesh(vertices=vertices):
            return Convex(pose.transform(np.asarray(vertices, dtype=np.float64)))
        case _:
            return None


def distance(first: Convex, second: Convex) -> float:
    """Return the distance (m) between two shapes; zero where they overlap, however deep."""
    return max(0.0, _core_distance(first, second, np.inf) - first.radius - second.radius)


def within(first: Convex, second: Convex, reach: float) -> bool:
    """Return True if two shapes come within ``reach`` (m) of each other; quicker than their distance."""
    # Bounding boxes first: most pairs of links are far apart.
    (low, high), (least, most) = first.bounds(), second.bounds()
    if np.any(high + reach < least) or np.any(most + reach < low):
        return False
    between = reach + first.radius + second.radius
    return _core_distance(first, second, between) <= between


def _core_distance(first: Convex, second: Convex, enough: float) -> float:
    """Return the distance (m) of the cores, or a lower bound of it that exceeds ``enough``."""
    simplex = (first.points[0] - second.points[0])[None]
    nearest = simplex[0]
    for _ in range(_ROUNDS):
        length = float(np.linalg.norm(nearest))
        if length < _EXACT:
            return 0.0
        support = first.support(-nearest) - second.support(nearest)
        bound = float(support @ nearest) / length
        # The separating plane alone proves the distance: no need for the exact one.
        if bound > enough:
            return bound
        if length - bound < _EXACT:
            return length
        nearest, simplex = _nearest(np.concatenate([simplex, support[None]]))
    return float(np.linalg.norm(nearest))


def _nearest(simplex: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Find the point of a simplex (P, 3) nearest to the origin, and the corners of the face that contains it."""
    best, face, least = simplex[-1], simplex[-1:], np.inf
    # At most 4 corners span a face in three dimensions.
    for count in range(1, min(len(simplex), 4) + 1):
        for chosen in combinations(range(len(simplex)), count):
            corners = simplex[list(chosen)]
            point = _foot(corners)
            if point is not None and (square := float(point @ point)) < least:
                best, face, least = point, corners, square
    return best, face


def _foot(corners: FloatArray) -> FloatArray | None:
    """Return the point of the plane, line or space through ``corners`` nearest to the origin, if it is between them."""
    if len(corners) == 1:
        return corners[0]
    edges = corners[1:] - corners[0]
    gram = edges @ edges.T
    scale = np.trace(gram)
    if np.linalg.det(gram) <= 1e-14 * scale ** len(edges):
        return None  # a flat simplex: one of its faces holds the point as well
    weights = np.linalg.solve(gram, -edges @ corners[0])
    if np.any(weights < 0.0) or weights.sum() > 1.0:
        return None
    return corners[0] + weights @ edges


def _ends(half_length: float) -> FloatArray:
    return np.array([[0.0, 0.0, -half_length], [0.0, 0.0, half_length]])


# Links of one robot that touch each other at home ---------------------------------------------------------------------
# A robot that collides with itself must not do so at home: contact would push its links apart from the first step on.
# Files often have such pairs, for their collision shapes are wider than the parts (hulls of a wrist and the link before
# the last), or for the real thing is built into a recess. These pairs are taken out of collision, and noted.

# Metres between links that count as touching: a drive that holds home lets them move by as much.
_CLEARANCE = 1e-3


def without_home_contacts(articulation: Articulation, home: Mapping[str, float]) -> Articulation:
    """Exclude collision of each pair of links that touch at home, with a note of them.

    Links touch where their collision shapes come within a millimetre of each other; meshes count as their convex
    hulls. Links that a joint connects never collide anyway. Whether the links collide with each other at all is left
    to ``self_collisions``.

    Args:
        articulation: the description.
        home: joint positions (rad, m) by regular expression over joint names (full match), zero or the nearest limit
            elsewhere.

    Raises:
        UnknownNameError: a key of ``home`` matches no joint.
        ConfigurationError: a position is outside its joint's limits.
    """
    merged = merge_fixed_links(articulation)  # links that fixed joints connect are one body
    at_home = home_positions(Entity(name=articulation.name, articulation=merged, home=home))
    positions = dict(zip(merged.joint_names, at_home.tolist(), strict=True))
    pairs = tuple(touching_links(merged, positions))
    if not pairs:
        return articulation
    told = ", ".join(f"{first} with {second}" for first, second in pairs)
    note = f"links that touch each other at home do not collide: {told}"
    return replace(
        articulation,
        collision_exclusions=(*articulation.collision_exclusions, *pairs),
        notes=(*articulation.notes, note),
    )


def touching_links(articulation: Articulation, positions: Mapping[str, float]) -> Iterator[tuple[str, str]]:
    """Yield pairs of links that touch at joint positions (rad, m), without joined and excluded ones.

    Links must be in topological order.
    """
    apart = {frozenset(pair) for pair in (*articulation.joined_links, *articulation.collision_exclusions)}
    shapes = _placed(articulation, positions)
    for first, second in combinations(shapes, 2):
        if frozenset((first, second)) not in apart and any(
            within(one, other, _CLEARANCE) for one in shapes[first] for other in shapes[second]
        ):
            yield first, second


def _placed(articulation: Articulation, positions: Mapping[str, float]) -> dict[str, list[Convex]]:
    """Return the collision shapes in the root's frame, of the links that have any."""
    poses = link_poses(articulation, positions)
    placed = {
        link.name: [convex_shape(shape, poses[link.name]) for shape in link.collisions] for link in articulation.links
    }
    return {name: found for name, shapes in placed.items() if (found := [shape for shape in shapes if shape])}
