"""Distance of a robot from obstacles, computed for balls that cover the shapes moved by its joints."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor

from orbit_core.dynamics.kinematics import KinematicTree, joint_ancestry
from orbit_core.dynamics.transforms import quat_rotate
from orbit_core.scene import Articulation, Box, Capsule, Cylinder, Mesh, Pose, Shape, Sphere
from orbit_motion.obstacles import Obstacles
from orbit_motion.still import PlacedRobot

_Array = npt.NDArray[np.float64]
# Most balls per shape.
_MOST = 6
# Boxes within this size (m) are fingertips, which must go closer to things than balls around slices allow.
_SMALL = 0.03
# Points around a ring of a round shape.
_RING = 8


@dataclass(frozen=True)
class CollisionSpheres:
    """Balls (S,) that cover the collision shapes: their links' indices, centres (S, 3) in those, and radii, m."""

    links: npt.NDArray[np.int64]
    centers: _Array
    radii: _Array


def collision_spheres(articulation: Articulation) -> CollisionSpheres:
    """Cover each collision shape by balls around slices, cut across its longest direction.

    They cover the surface, and stand out of it by some centimetres on broad shapes. Planes and height fields, which no
    robot carries, are left out.
    """
    found = [
        (link, center, radius)
        for link, body in enumerate(articulation.links)
        for shape in body.collisions
        for center, radius in _balls(shape)
    ]
    links, centers, radii = zip(*found, strict=True) if found else ((), (), ())
    return CollisionSpheres(np.array(links, dtype=np.int64), np.array(centers).reshape(-1, 3), np.array(radii))


def _balls(shape: Shape) -> list[tuple[_Array, float]]:
    if isinstance(shape.geometry, Sphere):
        return [(np.asarray(shape.pose.position), shape.geometry.radius)]
    if isinstance(shape.geometry, Box) and 2.0 * max(shape.geometry.half_extents) < _SMALL:
        return _eighths(shape.geometry, shape.pose)
    points = _surface(shape)
    if not len(points):
        return []
    points = points @ shape.pose.rotation_matrix().T + np.asarray(shape.pose.position)
    middle = points.mean(0)
    # The principal axes of the points: the first is the longest direction.
    axes = np.linalg.svd(points - middle, full_matrices=False)[2]
    along = (points - middle) @ axes[0]
    across = (points - middle) @ axes[1]
    length, width = np.ptp(along), max(np.ptp(across), 1e-3)
    # As many slices as make each about as long as wide.
    count = int(np.clip(round(length / width) + 1, 1, _MOST))
    edges = np.linspace(along.min(), along.max(), count + 1)
    slack = length / count / 4
    return [
        _ball(points[(along >= low - slack) & (along <= high + slack)])
        for low, high in itertools.pairwise(edges)
        if ((along >= low - slack) & (along <= high + slack)).any()
    ]


def _eighths(box: Box, pose: Pose) -> list[tuple[_Array, float]]:
    """Return a ball around each part of a box that is halved in every direction except thin ones."""
    half = np.asarray(box.half_extents)
    cells = np.where(half < 0.5 * half.max(), 1, 2)
    part = half / cells
    offsets = itertools.product(
        *[(np.arange(count) * 2 + 1 - count) * size for count, size in zip(cells, part, strict=True)]
    )
    turned = np.array(list(offsets)) @ pose.rotation_matrix().T + np.asarray(pose.position)
    return [(center, float(np.linalg.norm(part))) for center in turned]


def _ball(points: _Array) -> tuple[_Array, float]:
    center = (points.min(0) + points.max(0)) / 2
    for share in np.linspace(0.5, 0.02, 40):  # towards the furthest point, ever less: Badoiu and Clarkson, 2003
        furthest = points[np.linalg.norm(points - center, axis=1).argmax()]
        center = center + share * 0.2 * (furthest - center)
    return center, float(np.linalg.norm(points - center, axis=1).max())


def _surface(shape: Shape) -> _Array:
    """Return points (P, 3) on the surface, in the shape's frame."""
    geometry = shape.geometry
    grid = np.linspace(-1.0, 1.0, 7)
    if isinstance(geometry, Box):
        # Points of the grid with a coordinate of 1 are on the cube's surface.
        cube = np.stack(np.meshgrid(grid, grid, grid), -1).reshape(-1, 3)
        return cube[np.abs(cube).max(1) == 1.0] * np.asarray(geometry.half_extents)
    if isinstance(geometry, Capsule | Cylinder):
        angles = np.linspace(0.0, 2.0 * np.pi, _RING, endpoint=False)
        ring = np.stack((np.cos(angles), np.sin(angles), np.zeros(_RING)), 1) * geometry.radius
        rings = [ring + np.array([0.0, 0.0, z * geometry.half_length]) for z in grid]
        caps = geometry.half_length + (geometry.radius if isinstance(geometry, Capsule) else 0.0)
        return np.concatenate((*rings, [[0.0, 0.0, caps], [0.0, 0.0, -caps]]))
    if isinstance(geometry, Mesh):
        corners = np.asarray(geometry.vertices, dtype=np.float64)[np.asarray(geometry.faces)]
        middles = (corners + np.roll(corners, 1, axis=1)) / 2
        return np.concatenate((corners.reshape(-1, 3), middles.reshape(-1, 3), corners.mean(1)))
    return np.zeros((0, 3))


class Clearance:
    """Balls around the links that some joints move, and the obstacles that count for each.

    What a ball touches in all environments with the robot at home, such as the table that it stands on, is no obstacle
    to it.

    Args:
        robot: that moves.
        joints: indices of the joints.
        tree: the robot's kinematics.
        obstacles: that it keeps off.
    """

    def __init__(self, robot: PlacedRobot, joints: Sequence[int], tree: KinematicTree, obstacles: Obstacles) -> None:
        articulation, device = robot.spec.articulation, robot.joint_positions.device
        balls = collision_spheres(articulation)
        ancestry = joint_ancestry(articulation)[:, list(joints)]
        moved = ancestry[balls.links].any(1)
        self.obstacles = obstacles
        self.links = torch.as_tensor(balls.links[moved], device=device)
        """Link index of each ball, (S,)."""
        self.centers = torch.as_tensor(balls.centers[moved], dtype=torch.float32, device=device)
        """Centres of the balls (S, 3) in their links' frames."""
        self.radii = torch.as_tensor(balls.radii[moved], dtype=torch.float32, device=device)
        """Radii of the balls (S,) in m."""
        self.moves = torch.as_tensor(ancestry[balls.links[moved]], dtype=torch.float32, device=device)
        """Joints that move each ball, (S, k): 1 where the joint does, else 0."""
        home = robot.home_positions.expand(robot.joint_positions.shape[0], -1)
        distances, _ = obstacles.distances(self.points(tree.forward(robot.root_pose, home)))
        # Judged over all environments together: objects may be elsewhere later.
        self.counts = torch.where(((distances - self.radii[:, None]) < 0.0).all(0), 0.0, 1.0)
        """Pairs that count, (S, O): 1 where the obstacle counts for the ball."""

    def points(self, links: Tensor) -> Tensor:
        """Compute the centres (N, S, 3) of the balls for link poses (N, L, 7)."""
        poses = links.index_select(1, self.links)
        return poses[..., :3] + quat_rotate(poses[..., 3:], self.centers)

    def gaps(self, links: Tensor, env: int | None = None) -> Tensor:
        """Compute the distance (N, S, O) in m from each ball to each obstacle, negative where they overlap.

        It is infinite where an obstacle does not count.

        Args:
            links: link poses (N, L, 7).
            env: environment whose obstacles are used for any number N of postures; None takes each environment's own.
        """
        distances, _ = self.obstacles.distances(self.points(links), env)
        return torch.where(self.counts > 0.0, distances - self.radii[:, None], torch.inf)
