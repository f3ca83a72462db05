"""Distances from points to the scene's shapes, with the directions away from them."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor

from orbit_core.dynamics.kinematics import KinematicTree, joint_ancestry
from orbit_core.dynamics.transforms import pose_multiply, quat_rotate, quat_rotate_inverse
from orbit_core.interfaces import UnknownNameError
from orbit_core.scene import Articulation, Box, Capsule, Cylinder, HeightField, Mesh, Plane, Pose, Shape, Sphere
from orbit_motion.compliant import PlacedObject, PlacedRobot, PlacedWorld

TERRAIN = "terrain"
"""Name of the scene's static shapes among obstacles."""
# Metres to a shape where there is none.
_FAR = 1e3


@dataclass(frozen=True, eq=False)
class _Kind:
    """Shapes of one kind (O,): sizes (O, 3), and poses (O, 7) in their links, or in the world without one."""

    sizes: Tensor
    poses: Tensor
    owners: tuple[tuple[str, int] | None, ...]
    """Name of the object and index of its link, None for terrain."""


class Obstacles:
    """Shapes of the terrain and of objects, at their present poses.

    Boxes, balls, capsules, cylinders and planes are exact. A mesh or height field counts as the box around it.

    Args:
        world: that they are in.
        names: of objects, and :data:`TERRAIN`; None takes static shapes: the terrain, and of all objects whose
            base is fixed the links that no joint of theirs moves.

    Raises:
        UnknownNameError: the world has no such object.
    """

    def __init__(self, world: PlacedWorld, names: Sequence[str] | None) -> None:
        still = names is None
        if names is None:
            names = (TERRAIN, *(name for name, thing in world.objects.items() if thing.spec.fixed_base))
        for name in names:
            if name != TERRAIN and name not in world.objects:
                raise UnknownNameError("object", name, [TERRAIN, *world.objects], "the world")
        self._objects: dict[str, PlacedObject] = {name: world.objects[name] for name in names if name != TERRAIN}
        shapes: list[tuple[Shape, tuple[str, int] | None]] = []
        if TERRAIN in names:
            shapes += [(shape, None) for shape in world.scene.terrain]
        for name, thing in self._objects.items():
            moved = np.any(joint_ancestry(thing.spec.articulation), axis=1).tolist()
            links = zip(thing.spec.articulation.links, moved, strict=True)
            shapes += [
                (shape, (name, index))
                for index, (link, by_joint) in enumerate(links)
                for shape in link.collisions
                if not (still and by_joint)
            ]
        self._device = world.device
        identity = torch.tensor([0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0], device=world.device)
        self._world_pose = identity.expand(world.num_envs, 7)
        self._kinds = {kind: self._gathered(kind, shapes) for kind in (Box, Sphere, Capsule, Cylinder, Plane)}
        self.count = sum(len(kind.owners) for kind in self._kinds.values())
        """Number of shapes, O."""
        owners = [owner for kind in self._kinds.values() for owner in kind.owners]
        self.names = tuple(TERRAIN if owner is None else owner[0] for owner in owners)
        """Name of each shape's object."""

    def distances(self, points: Tensor, env: int | None = None) -> tuple[Tensor, Tensor]:
        """Compute distances (N, S, O) in m from points (N, S, 3), negative inside, and unit vectors (N, S, O, 3) away.

        With ``env`` the shapes are where they are in that environment, and N is any number.
        """
        return self.distances_of(self.poses(env).unsqueeze(1), points)

    def poses(self, env: int | None = None) -> Tensor:
        """Return the poses (N, O, 7) of the shapes; (1, O, 7) in one environment."""
        found = [self._poses(parts) for parts in self._kinds.values() if parts.owners]
        poses = torch.cat(found, 1) if found else self._world_pose[:, None][:, :0]
        return poses if env is None else poses[env : env + 1]

    def distances_of(self, poses: Tensor, points: Tensor) -> tuple[Tensor, Tensor]:
        """Compute :meth:`distances`, (..., O) and (..., O, 3), for :meth:`poses` (..., O, 7) and points (..., 3)."""
        counts = [len(parts.owners) for parts in self._kinds.values()]
        found = [
            self._of_kind(kind, parts, placed, points)
            # One call per kind of shape: each law is one batched kernel.
            for (kind, parts), placed in zip(self._kinds.items(), poses.split(counts, -2), strict=True)
            if parts.owners
        ]
        if not found:
            return points.new_full((*points.shape[:-1], 0), _FAR), points.new_zeros((*points.shape[:-1], 0, 3))
        return torch.cat([distance for distance, _ in found], -1), torch.cat([away for _, away in found], -2)

    def _of_kind(self, kind: type, parts: _Kind, poses: Tensor, points: Tensor) -> tuple[Tensor, Tensor]:
        local = quat_rotate_inverse(poses[..., 3:], points.unsqueeze(-2) - poses[..., :3])
        distance, away = _LAWS[kind](local, parts.sizes)
        return distance, quat_rotate(poses[..., 3:], away)

    def _poses(self, parts: _Kind) -> Tensor:
        """Return the poses (N, O, 7) of one kind."""
        links = [
            self._world_pose if owner is None else self._objects[owner[0]].link_poses[:, owner[1]]
            for owner in parts.owners
        ]
        return pose_multiply(torch.stack(links, 1), parts.poses)

    def _gathered(self, kind: type, shapes: Sequence[tuple[Shape, tuple[str, int] | None]]) -> _Kind:
        chosen = [(simple, owner) for shape, owner in shapes if isinstance((simple := _simple(shape)).geometry, kind)]
        sizes = [_sizes(shape) for shape, _ in chosen]
        poses = [(*shape.pose.position, *shape.pose.orientation) for shape, _ in chosen]
        sized, placed = (torch.tensor(part, dtype=torch.float32, device=self._device) for part in (sizes, poses))
        return _Kind(sized, placed, tuple(owner for _, owner in chosen))


def _simple(shape: Shape) -> Shape:
    """Return the shape itself, or the box around it."""
    if isinstance(shape.geometry, Mesh):
        points = np.asarray(shape.geometry.vertices)
        low, high = points.min(0), points.max(0)
    elif isinstance(shape.geometry, HeightField):
        heights, (x, y) = np.asarray(shape.geometry.heights), shape.geometry.size
        # A little below the lowest point, so that the box has a thickness.
        low, high = np.array([-x / 2, -y / 2, heights.min() - 0.1]), np.array([x / 2, y / 2, heights.max()])
    else:
        return shape
    middle, half = (low + high) / 2, (high - low) / 2
    pose = shape.pose @ Pose((float(middle[0]), float(middle[1]), float(middle[2])))
    return Shape(Box((float(half[0]), float(half[1]), float(half[2]))), pose=pose)


def _sizes(shape: Shape) -> tuple[float, float, float]:
    geometry = shape.geometry
    if isinstance(geometry, Box):
        return geometry.half_extents
    if isinstance(geometry, Capsule | Cylinder):
        return (geometry.radius, geometry.half_length, 0.0)
    return (geometry.radius if isinstance(geometry, Sphere) else 0.0, 0.0, 0.0)


def _box(local: Tensor, sizes: Tensor) -> tuple[Tensor, Tensor]:
    # Inside, the nearest face is the one with the least depth; outside, the offset beyond the faces counts.
    beyond = local.abs() - sizes
    outside = beyond.clamp_min(0.0)
    deepest = beyond.amax(-1, keepdim=True)
    length = torch.linalg.vector_norm(outside, dim=-1, keepdim=True)
    sign = torch.where(local < 0.0, -1.0, 1.0)
    inward = (beyond == deepest).to(local.dtype)
    away = torch.where(length > 0.0, outside / length.clamp_min(1e-9), inward) * sign
    return torch.where(length > 0.0, length, deepest).squeeze(-1), away


def _round(vector: Tensor, radius: Tensor) -> tuple[Tensor, Tensor]:
    length = torch.linalg.vector_norm(vector, dim=-1, keepdim=True)
    return length.squeeze(-1) - radius, vector / length.clamp_min(1e-9)


def _sphere(local: Tensor, sizes: Tensor) -> tuple[Tensor, Tensor]:
    return _round(local, sizes[:, 0])


def _capsule(local: Tensor, sizes: Tensor) -> tuple[Tensor, Tensor]:
    height = torch.clamp(local[..., 2], -sizes[:, 1], sizes[:, 1])
    zero = torch.zeros_like(height)
    return _round(local - torch.stack((zero, zero, height), -1), sizes[:, 0])


def _cylinder(local: Tensor, sizes: Tensor) -> tuple[Tensor, Tensor]:
    radial = torch.linalg.vector_norm(local[..., :2], dim=-1)
    plane = torch.stack((radial, local[..., 2]), -1)
    # In the half plane of radius and height a cylinder is a box.
    distance, away = _box(plane, sizes[:, :2])
    outward = local[..., :2] / radial.unsqueeze(-1).clamp_min(1e-9)
    return distance, torch.cat((outward * away[..., :1], away[..., 1:]), -1)


def _plane(local: Tensor, sizes: Tensor) -> tuple[Tensor, Tensor]:
    zero = torch.zeros_like(local[..., 2])
    return local[..., 2], torch.stack((zero, zero, zero + 1.0), -1)


_LAWS = {Box: _box, Sphere: _sphere, Capsule: _capsule, Cylinder: _cylinder, Plane: _plane}


# Distance of a robot from obstacles, computed for balls that cover the shapes moved by its joints ---------------------

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
    """(S,) index of the link that carries each."""
    centers: _Array
    """(S, 3) m, in the link's frame."""
    radii: _Array
    """(S,) m."""


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
