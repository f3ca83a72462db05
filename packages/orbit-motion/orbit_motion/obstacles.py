"""Distances from points to the scene's shapes, with the directions away from them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from orbit_core.dynamics.kinematics import joint_ancestry
from orbit_core.dynamics.transforms import pose_multiply, quat_rotate, quat_rotate_inverse
from orbit_core.interfaces import UnknownNameError
from orbit_core.scene import Box, Capsule, Cylinder, HeightField, Mesh, Plane, Pose, Shape, Sphere
from orbit_motion.still import PlacedObject, PlacedWorld

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
