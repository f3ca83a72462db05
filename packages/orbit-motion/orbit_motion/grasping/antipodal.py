"""Antipodal grasps: two points of a surface whose line is in both friction cones, ranked by how well they would hold.

Two fingers with friction hold a thing in all directions where the line between them is within both friction cones:
Nguyen, Constructing Force-Closure Grasps (International Journal of Robotics Research 7(3), 1988). Candidates are drawn
and the patch between the fingers judged as ten Pas et al. do, Grasp Pose Detection in Point Clouds (International
Journal of Robotics Research 36(13), 2017). Surfaces are points with normals, of collision shapes or of a depth camera's
cloud; the gripper is a set of boxes around its links, wide open.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from torch import Tensor
from torch.nn.functional import normalize

from orbit_assets.audit.robots.postures import gripper_posture, gripping_links, shapes_in_frame
from orbit_core.dynamics.transforms import quat_from_matrix, quat_rotate_inverse, quat_to_matrix
from orbit_core.interfaces import ArgumentError, ConfigurationError
from orbit_core.plugin_kit.meshes import triangles
from orbit_core.scene import Gripper, HeightField, Link, Plane, RobotSpec

# Metres along the approach from the frame within which fingers limit the opening.
_NEAR = 0.01


@dataclass(frozen=True, eq=False)
class HandBoxes:
    """Boxes (B, 2, 3), least and largest corner in m, and the opening (m) between fingers along the frame's y."""

    boxes: Tensor
    opening: float
    points: Tensor
    """Points (P, 3) in m on the shapes themselves."""

    @staticmethod
    def of(spec: RobotSpec) -> HandBoxes:
        """Compute the boxes of a robot's first end effector, with its gripper open.

        Raises:
            ConfigurationError: it has no gripper, or nothing of it is on both sides of its frame.
        """
        effector = spec.end_effectors[0] if spec.end_effectors else None
        if effector is None or effector.gripper is None:
            raise ConfigurationError(f"robot '{spec.name}' has no gripper to grasp with")
        posture = gripper_posture(spec, effector.gripper, effector.gripper.open_position)
        clouds = shapes_in_frame(spec, effector.frame, _hand_links(spec, effector.gripper), posture)
        boxes = [torch.tensor(np.stack((cloud.min(0), cloud.max(0))), dtype=torch.float32) for cloud in clouds]
        stacked = torch.stack(boxes) if boxes else torch.zeros(0, 2, 3)
        points = torch.tensor(np.concatenate(clouds or [np.zeros((0, 3))]), dtype=torch.float32)
        return HandBoxes(stacked, _opening(stacked, spec.name), points)

    def touches(self, points: Tensor, margin: float = 0.0) -> Tensor:
        """Return True (...,) if any of the points (..., M, 3) in the end effector's frame is within ``margin`` m of a
        box.
        """
        low, high = self.boxes[:, 0] - margin, self.boxes[:, 1] + margin
        inside = (points[..., None, :] > low.to(points)) & (points[..., None, :] < high.to(points))
        return inside.all(-1).any(-1).any(-1)


def _hand_links(spec: RobotSpec, gripper: Gripper) -> list[Link]:
    """Return the links that the gripper moves, and the links that carry them."""
    moving = {link.name for link in gripping_links(spec, gripper)}
    carriers = {joint.parent for joint in spec.articulation.joints if joint.child in moving}
    return [link for link in spec.articulation.links if link.name in moving | carriers]


def _opening(boxes: Tensor, name: str) -> float:
    near = (boxes[:, 0, 2] < _NEAR) & (boxes[:, 1, 2] > -_NEAR)
    left, right = near & (boxes[:, 0, 1] > 0.0), near & (boxes[:, 1, 1] < 0.0)
    if not left.any() or not right.any():
        raise ConfigurationError(f"the gripper of '{name}' has no finger on each side of its frame: it is not parallel")
    return float(boxes[left, 0, 1].min() - boxes[right, 1, 1].max())


# Neighbours of a point in a cloud from which its normal is estimated.
_NEIGHBOURS = 16


@dataclass(frozen=True, eq=False)
class Surface:
    """Points (M, 3) in metres and unit normals (M, 3) pointing outwards, in one frame."""

    points: Tensor
    normals: Tensor

    def __post_init__(self) -> None:
        if self.points.shape != self.normals.shape or self.points.ndim != 2 or self.points.shape[1] != 3:
            raise ArgumentError(
                f"a surface has points {tuple(self.points.shape)} and normals {tuple(self.normals.shape)}: "
                "give (M, 3) each"
            )


def surface_of(link: Link, count: int = 2000, seed: int = 0) -> Surface:
    """Sample ``count`` points evenly from a link's collision shapes, in the link's frame.

    Raises:
        ArgumentError: the link has no collision shape of finite size.
    """
    import trimesh

    shapes = [shape for shape in link.collisions if not isinstance(shape.geometry, Plane | HeightField)]
    if not shapes:
        raise ArgumentError(f"link '{link.name}' has no collision shapes of finite size: there is nothing to grasp")
    meshes = []
    for shape in shapes:
        mesh = triangles(shape.geometry)
        mesh.apply_transform(shape.pose.matrix())
        meshes.append(mesh)
    joined: Any = trimesh.util.concatenate(meshes)
    points, faces, *_ = trimesh.sample.sample_surface(joined, count, seed=seed)
    return Surface(
        torch.as_tensor(np.asarray(points), dtype=torch.float32),
        torch.as_tensor(np.asarray(joined.face_normals[faces]), dtype=torch.float32),
    )


def surface_of_cloud(points: Tensor, eye: Tensor) -> Surface:
    """Estimate normals of points (M, 3) that a camera at ``eye`` (3,) saw; they point towards it.

    A normal is the direction in which a point's 16 nearest vary least: Hoppe et al., Surface Reconstruction from
    Unorganized Points (SIGGRAPH 1992).

    Raises:
        ArgumentError: there are fewer points than a neighbourhood has.
    """
    if len(points) < _NEIGHBOURS:
        raise ArgumentError(f"a cloud of {len(points)} points has no normals: give {_NEIGHBOURS} or more")
    nearest = torch.cdist(points, points).topk(_NEIGHBOURS, largest=False).indices
    around = points[nearest]
    spread = around - around.mean(1, keepdim=True)
    # Eigenvalues ascend: the first eigenvector is the direction of least variation.
    _, axes = torch.linalg.eigh(spread.transpose(1, 2) @ spread)
    normals = axes[:, :, 0]
    away = ((points - eye) * normals).sum(1, keepdim=True) > 0.0
    return Surface(points, torch.where(away, -normals, normals))


# Least distance (m) between an open finger and the thing.
_CLEARANCE = 0.002
# Metres around the line between the fingers within which the surface is judged.
_PATCH = 0.01
# Points of the surface that are tested against the hand.
_CHECKED = 400
# Least distance (m) between the two points of a grasp.
_SPARSE = 1e-3


@dataclass(frozen=True, kw_only=True)
class GraspConfig:
    """Sampling of candidates.

    Raises:
        ArgumentError: a number is out of its range.
    """

    friction: float = 0.5
    """Coefficient between fingers and thing."""
    samples: int = 400
    """Points from which a line to the other side is drawn."""
    directions: int = 12
    """Directions of approach, evenly around each line."""
    most: int = 64
    """Most candidates that are returned, the best ones."""
    seed: int = 0

    def __post_init__(self) -> None:
        for name in ("friction", "samples", "directions", "most"):
            if not getattr(self, name) > 0:
                raise ArgumentError(f"setting '{name}' of grasp candidates is {getattr(self, name)}: give more than 0")


@dataclass(frozen=True, eq=False)
class GraspCandidates:
    """K grasps, the best first, in the frame of the surface."""

    poses: Tensor
    """Poses (K, 7) of the end effector: z along the approach, y from one finger to the other."""
    widths: Tensor
    """Distances (K,) in m between the two points."""
    contacts: Tensor
    """Contact points (K, 2, 3) in m."""
    scores: Tensor
    """Scores (K,) from 0 to 1."""

    def __len__(self) -> int:
        return len(self.scores)


def grasp_candidates(
    surface: Surface, hand: HandBoxes, config: GraspConfig = GraspConfig(), up: Tensor | None = None
) -> GraspCandidates:
    """Find grasps of a surface by a hand, ranked by the mean of four scores.

    They are: how far inside the friction cones the line is; how near the line goes to the thing's middle, so that it
    hardly turns in the hand; which part of the surface between the fingers faces them; and how far the approach is from
    above, where ``up`` (3,) is given in the surface's frame.

    Raises:
        ArgumentError: none is possible: the thing is too wide for the hand, or no two sides face each other.
    """
    pairs = _pairs(surface, hand.opening, config)
    if not len(pairs):
        raise ArgumentError(
            f"no grasp of {hand.opening:.3f} m at most with a friction coefficient of {config.friction:g}: no two "
            "sides of the thing face each other so near"
        )
    poses, contacts = _around(surface.points[pairs], config.directions)
    stride = max(1, len(surface.points) // _CHECKED)
    checked = Surface(surface.points[::stride], surface.normals[::stride])
    local = quat_rotate_inverse(poses[:, None, 3:], checked.points - poses[:, None, :3])
    free = ~hand.touches(local, _CLEARANCE)
    if not free.any():
        raise ArgumentError("every grasp would have the open hand inside the thing: its fingers do not reach around it")
    poses, contacts, local = poses[free], contacts[free], local[free]
    normals = surface.normals[pairs].repeat_interleave(config.directions, 0)[free]
    scores = [_cone(contacts, normals, config.friction), _central(contacts, surface), _facing(local, poses, checked)]
    if up is not None:
        approach = _axes(poses)[:, :, 2]
        scores.append(0.5 - 0.5 * (approach @ normalize(up, dim=0)))
    # Unweighted: none of the scores is a probability, and none has shown to matter more.
    score = torch.stack(scores).mean(0)
    best = score.argsort(descending=True, stable=True)[: config.most]
    width = torch.linalg.vector_norm(contacts[:, 1] - contacts[:, 0], dim=1)
    return GraspCandidates(poses[best], width[best], contacts[best], score[best])


def _pairs(surface: Surface, opening: float, config: GraspConfig) -> Tensor:
    """Return index pairs (K, 2) of points that face each other within the opening and the cones."""
    points, normals = surface.points, surface.normals
    generator = torch.Generator().manual_seed(config.seed)
    first = torch.randint(len(points), (config.samples,), generator=generator).to(points.device)
    angle = math.atan(config.friction)
    noise = torch.randn(config.samples, 3, generator=generator).to(points)
    # A line within the friction cone: tilted from the normal by less than its angle.
    lean = torch.rand(config.samples, 1, generator=generator).to(points) * math.tan(angle)
    across = normalize(noise - (noise * normals[first]).sum(1, keepdim=True) * normals[first], dim=1)
    line = normalize(across * lean - normals[first], dim=1)
    arms = points - points[first][:, None]
    along = (arms * line[:, None]).sum(-1)
    aside = torch.linalg.vector_norm(arms - along[..., None] * line[:, None], dim=-1)
    # The spacing of points: half of them have the nearest other closer than that.
    spacing = torch.cdist(points[first], points).topk(2, largest=False).values[:, 1].median()
    last = torch.where(aside < 2.0 * spacing, along, -torch.inf).argmax(1)
    pairs = torch.stack((first, last), dim=1)
    axis = points[last] - points[first]
    width = torch.linalg.vector_norm(axis, dim=1)
    axis = axis / width[:, None].clamp_min(_SPARSE)
    least = math.cos(angle)
    closed = ((-normals[first] * axis).sum(1) >= least) & ((normals[last] * axis).sum(1) >= least)
    return pairs[closed & (width > _SPARSE) & (width < opening - 2.0 * _CLEARANCE)]


def _around(ends: Tensor, directions: int) -> tuple[Tensor, Tensor]:
    """Return poses (K D, 7) between points (K, 2, 3), and those points for each."""
    y = normalize(ends[:, 1] - ends[:, 0], dim=1)
    least = torch.nn.functional.one_hot(y.abs().argmin(1), 3).to(y)
    # The axis that is least parallel to the line gives a well-conditioned side.
    side = normalize(torch.linalg.cross(y, least), dim=1)
    other = torch.linalg.cross(y, side)
    turns = torch.arange(directions, device=y.device) * (2.0 * math.pi / directions)
    z = side[:, None] * turns.cos()[:, None] + other[:, None] * turns.sin()[:, None]
    y = y[:, None].expand_as(z)
    axes = torch.stack((torch.linalg.cross(y, z), y, z), dim=-1)
    middle = ends.mean(1)[:, None].expand_as(z)
    poses = torch.cat((middle, quat_from_matrix(axes)), dim=-1).flatten(0, 1)
    return poses, ends.repeat_interleave(directions, 0)


def _axes(poses: Tensor) -> Tensor:
    return quat_to_matrix(poses[:, 3:])


def _cone(contacts: Tensor, normals: Tensor, friction: float) -> Tensor:
    """Score (K,): 1 where the line is along both normals, 0 at the edge of a cone."""
    axis = normalize(contacts[:, 1] - contacts[:, 0], dim=1)
    cosine = torch.minimum(-(normals[:, 0] * axis).sum(1), (normals[:, 1] * axis).sum(1))
    return 1.0 - torch.arccos(cosine.clamp(-1.0, 1.0)) / math.atan(friction)


def _central(contacts: Tensor, surface: Surface) -> Tensor:
    """Score (K,): 1 where the line passes through the middle of the points, 0 at their farthest from it."""
    middle = surface.points.mean(0)
    size = torch.linalg.vector_norm(surface.points - middle, dim=1).max()
    axis = normalize(contacts[:, 1] - contacts[:, 0], dim=1)
    arm = middle - contacts[:, 0]
    off = torch.linalg.vector_norm(arm - (arm * axis).sum(1, keepdim=True) * axis, dim=1)
    return 1.0 - (off / size).clamp(0.0, 1.0)


def _facing(local: Tensor, poses: Tensor, surface: Surface) -> Tensor:
    """Score (K,): mean component of the normals along the line, over the surface that the pads would touch."""
    between = (local[..., 0].abs() < _PATCH) & (local[..., 2].abs() < _PATCH)
    along = (surface.normals @ _axes(poses)[:, :, 1].transpose(0, 1)).transpose(0, 1).abs()
    return (along * between).sum(1) / between.sum(1).clamp_min(1)
