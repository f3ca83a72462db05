"""Cameras of spectators: framed by what a task moves, and following what walks or drives."""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor

from orbit_core.dynamics.transforms import quat_rotate, quat_rotate_inverse, transform_points
from orbit_core.interfaces import EntityLayout, World
from orbit_core.scene import (
    Box,
    Capsule,
    Cylinder,
    Geometry,
    HeightField,
    Link,
    Mesh,
    Plane,
    Pose,
    RobotSpec,
    Shape,
    Sphere,
)

FIELD_OF_VIEW = 0.7
"""Vertical field of view of spectators' cameras, in radians."""
# Part of the picture's width or height that what the task moves takes.
_FILLED = 0.7
# Least size in metres that is framed: closer, small things would fill the picture without what they lie on.
_LEAST = 0.22
# Metres from the scene's middle beyond which a marker counts as put away.
_AWAY = 20.0
# Metres from what is followed within which a marker belongs to it, such as the arrow of its command.
_NEAR = 1.5
# Metres around an end effector that belong to it.
_HAND = 0.1
# Metres up to which a fixed object, such as a bin or a holed block, is part of what the task is about.
_SMALL = 0.45
# Share of a deformable's points that are framed, without the drops and ends that are farthest off.
_KEPT = 0.98
# Corners of a cube from -1 to 1.
_CORNERS = torch.tensor([[x, y, z] for x in (-1.0, 1.0) for y in (-1.0, 1.0) for z in (-1.0, 1.0)])
# Seconds of lag of a following camera, sideways and up: steps of a gait stay in the picture, and do not shake it.
_LAG = (0.2, 0.2, 0.4)
# Metres from one picture to the next beyond which the camera jumps: the episode began again.
_JUMP = 0.5


def framed(world: World, view: Pose, aspect: float, follow: str = "", env: int = 0) -> Pose:
    """Return a view along the same direction, from where what the task moves fills most of the picture.

    Args:
        world: in its present state, which a task's start is a good one for.
        view: direction of the camera; its place, where the scene has nothing that moves.
        aspect: width of the picture over its height.
        follow: entity to frame alone; empty frames everything that moves, hands of arms and markers.
        env: the environment that is framed.
    """
    points = _points(world, follow, env)
    if not len(points):
        return view
    middle = 0.5 * (points.amin(0) + points.amax(0))
    points = torch.cat((points, middle + 0.5 * _LEAST * _CORNERS))
    _, orientation = _tensors(view)
    seen = quat_rotate_inverse(orientation.expand(len(points), 4), points - middle)
    up = math.tan(0.5 * FIELD_OF_VIEW) * _FILLED
    # A camera at (x, y, z) has a point (a, b, c) in its frame if |a - x| <= (z - c) tan: the least z that has all of
    # them is half the sum, over the tangent, of the two sides' largest a + c tan and -a + c tan.
    eye = torch.zeros(3)
    for axis, tangent in enumerate((up * aspect, up)):
        sides = [float((sign * seen[:, axis] + tangent * seen[:, 2]).max()) for sign in (1.0, -1.0)]
        eye[axis] = 0.5 * (sides[0] - sides[1])
        eye[2] = max(float(eye[2]), 0.5 * sum(sides) / tangent)
    x, y, z = (middle + quat_rotate(orientation[None], eye[None])[0]).tolist()
    return Pose((x, y, z), view.orientation)


class FollowingCamera:
    """Poses of a camera that moves with an entity of each environment, softly and without turning.

    Args:
        world: holds the entity.
        name: of the entity.
        view: pose of the camera while the entity is where it is now in environment 0.
    """

    def __init__(self, world: World, name: str, view: Pose) -> None:
        self._world = world
        self._link = world.layout.entity(name).root_link
        position, self._orientation = _tensors(view, world.device)
        roots = self._roots()
        self._offset = position - roots[0]
        self._target, self._place, self._speed = roots.clone(), roots.clone(), torch.zeros_like(roots)
        lag = torch.tensor(_LAG, device=world.device)
        self._rate = 1.0 / lag

    def poses(self, seconds: float) -> Tensor:
        """Return camera poses (N, 7), so many seconds after the call before."""
        roots = self._roots()
        jumped = ((roots - self._target).norm(dim=-1) > _JUMP)[:, None]
        self._target = roots
        # A critically damped spring, integrated exactly: stable for any time between two pictures.
        away = self._place - roots
        push = (self._speed + self._rate * away) * seconds
        fading = torch.exp(-self._rate * seconds)
        self._place = torch.where(jumped, roots, roots + (away + push) * fading)
        self._speed = torch.where(jumped, 0.0, (self._speed - self._rate * push) * fading)
        return torch.cat((self._place + self._offset, self._orientation.expand(len(roots), 4)), dim=-1)

    def _roots(self) -> Tensor:
        # A copy: engines write poses in place.
        return self._world.link_poses[:, self._link, :3].clone()


def _points(world: World, follow: str, env: int) -> Tensor:
    """Return (P, 3) corners around what is framed, in the environment's frame."""
    layout, poses = world.layout, world.link_poses[env].cpu()
    points: list[Tensor] = []
    # An arm without a thing to move is itself what is to be seen.
    hands = bool(layout.scene.objects) or bool(world.deformables)
    for entity in layout.entities:
        if follow:
            links = range(entity.links.start, entity.links.stop) if entity.name == follow else ()
        else:
            links = _moving_links(entity, hands)
        for link in links:
            corners = _corners(layout.links[link].visuals or layout.links[link].collisions)
            if len(corners):
                points.append(transform_points(poses[link].expand(len(corners), 7), corners))
        if not follow and hands and isinstance(entity.spec, RobotSpec) and entity.spec.fixed_base:
            points += [_hand(entity, entity.spec, effector.frame, poses) for effector in entity.spec.end_effectors]
    points.append(_marks(world, follow, env))
    if not follow:
        points += [_most(deformable.positions[env].cpu()) for deformable in world.deformables.values()]
    return torch.cat(points) if points else torch.zeros(0, 3)


def _marks(world: World, follow: str, env: int) -> Tensor:
    """Return corners (8 M, 3) of boxes around markers; around those near an entity, where one is followed."""
    places, markers = world.marker_poses[env, :, :3].cpu(), world.layout.scene.markers
    distance = places.norm(dim=-1)
    # A marker at the very origin was never placed.
    shown = distance > 0.0
    if follow:
        root = world.link_poses[env, world.layout.entity(follow).root_link, :3].cpu()
        shown &= (places - root).norm(dim=-1) < _NEAR
    else:
        shown &= distance < _AWAY
    half = 0.5 * torch.tensor([marker.size for marker in markers]).reshape(-1, 1, 1)
    return (places[:, None] + half * _CORNERS)[shown].reshape(-1, 3)


def _moving_links(entity: EntityLayout, hands: bool) -> range:
    """Return links that are framed: of what moves or is small, but none of an arm whose hand is framed apart."""
    spec = entity.spec
    arm = hands and isinstance(spec, RobotSpec) and bool(spec.end_effectors)
    if spec.fixed_base and (arm or not (spec.articulation.movable_joints or _is_small(spec.articulation.root))):
        return range(0)
    return range(entity.links.start, entity.links.stop)


def _is_small(link: Link) -> bool:
    corners = _corners(link.visuals or link.collisions)
    return len(corners) > 0 and float((corners.amax(0) - corners.amin(0)).max()) <= _SMALL


def _most(points: Tensor) -> Tensor:
    """Return points (P, 3) without the few that are farthest from their median."""
    away = (points - points.median(0).values).norm(dim=-1)
    return points[away <= away.quantile(_KEPT)]


def _hand(entity: EntityLayout, spec: RobotSpec, frame: str, poses: Tensor) -> Tensor:
    """Return corners (8, 3) of a box around an end effector's frame."""
    place = spec.articulation.frame(frame)
    link = entity.links.start + spec.articulation.link_names.index(place.link)
    origin = torch.tensor([place.pose.position], dtype=torch.float32)
    middle = transform_points(poses[link][None], origin)
    return middle + _HAND * _CORNERS


def _corners(shapes: tuple[Shape, ...]) -> Tensor:
    """Return (8 S, 3) corners of the boxes around shapes, in their link's frame."""
    found: list[npt.NDArray[np.float64]] = []
    for shape in shapes:
        low, high = _bounds(shape.geometry)
        grid = np.array([(x, y, z) for x in (low[0], high[0]) for y in (low[1], high[1]) for z in (low[2], high[2])])
        matrix = shape.pose.matrix()
        found.append(grid @ matrix[:3, :3].T + matrix[:3, 3])
    return torch.as_tensor(np.concatenate(found), dtype=torch.float32) if found else torch.zeros(0, 3)


def _bounds(geometry: Geometry) -> tuple[npt.NDArray[np.float64], npt.NDArray[np.float64]]:
    """Return the least and the greatest corner of a geometry; of a plane, which has none, the origin."""
    match geometry:
        case Mesh(vertices=vertices):
            return np.asarray(vertices).min(0), np.asarray(vertices).max(0)
        case Box(half_extents):
            half = np.asarray(half_extents)
        case Sphere(radius):
            half = np.full(3, radius)
        case Capsule(radius, half_length):
            half = np.array((radius, radius, half_length + radius))
        case Cylinder(radius, half_length):
            half = np.array((radius, radius, half_length))
        case HeightField(size=size):
            half = np.array((size[0] / 2, size[1] / 2, 0.0))
        case Plane():
            half = np.zeros(3)
    return -half, half


def _tensors(pose: Pose, device: torch.device | str = "cpu") -> tuple[Tensor, Tensor]:
    return torch.tensor(pose.position, device=device), torch.tensor(pose.orientation, device=device)
