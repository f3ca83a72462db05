"""Planes, boxes, spheres and capsules: how far points are from them, and where rays meet them.

C. Ericson, Real-Time Collision Detection (2005), sections 5.1 and 5.3. Everything is in the shape's own frame.
"""

from __future__ import annotations

import torch
from torch import Tensor

from orbit_core.scene import Box, Capsule, Plane, Sphere
from orbit_core.scene.shapes import Geometry

SOLIDS = (Plane, Box, Sphere, Capsule)
_CORNER = 0.02
"""Radius of a box's corners over its least half extent: what lies flush on a face is told from what lies beside it."""


def balls(geometry: Geometry, against: Geometry) -> tuple[Tensor, float]:
    """What touches another shape for a shape: balls' centres (P, 3), and their radius in metres; none of a plane.

    Of a box they are its corners, and the middles of its edges where the other is a box too.
    """
    match geometry:
        case Box(half_extents=half):
            radius = _CORNER * min(half)
            signs = torch.cartesian_prod(*[torch.tensor([-1.0, 0.0, 1.0], dtype=torch.float64)] * 3)
            signs = signs[signs.abs().sum(1) >= (2.0 if isinstance(against, Box) else 3.0)]
            return signs * (torch.tensor(half, dtype=torch.float64) - radius), radius
        case Sphere(radius=radius):
            return torch.zeros(1, 3, dtype=torch.float64), radius
        case Capsule(radius=radius, half_length=half):
            return torch.tensor([[0.0, 0.0, -half], [0.0, 0.0, half]], dtype=torch.float64), radius
        case _:
            return torch.zeros(0, 3, dtype=torch.float64), 0.0


def distance(geometry: Geometry, points: Tensor) -> tuple[Tensor, Tensor]:
    """Signed distance (...) of points (..., 3) from the surface, negative inside, and the outward normal (..., 3)."""
    match geometry:
        case Box(half_extents=half):
            return _distance_from_box(points, points.new_tensor(half))
        case Sphere(radius=radius):
            return _distance_from_segment(points, radius, 0.0)
        case Capsule(radius=radius, half_length=half):
            return _distance_from_segment(points, radius, half)
        case _:
            return points[..., 2], points.new_tensor([0.0, 0.0, 1.0]).expand_as(points)


def _distance_from_box(points: Tensor, half: Tensor) -> tuple[Tensor, Tensor]:
    beyond = points.abs() - half
    outside = beyond.clamp_min(0.0)
    reach = outside.norm(dim=-1, keepdim=True)
    deepest = torch.nn.functional.one_hot(beyond.argmax(-1), 3).to(points.dtype)
    normal = torch.where(reach > 1e-9, outside / reach.clamp_min(1e-12), deepest)
    return reach[..., 0] + beyond.amax(-1).clamp_max(0.0), torch.where(points < 0.0, -normal, normal)


def _distance_from_segment(points: Tensor, radius: float, half: float) -> tuple[Tensor, Tensor]:
    axis = torch.zeros_like(points)
    axis[..., 2] = points[..., 2].clamp(-half, half)
    away = points - axis
    length = away.norm(dim=-1, keepdim=True)
    return length[..., 0] - radius, away / length.clamp_min(1e-12)


def meet(geometry: Geometry, origins: Tensor, directions: Tensor) -> Tensor:
    """How far along rays (..., 3), in metres, the surface is met from outside; infinite for a miss (...)."""
    match geometry:
        case Box(half_extents=half):
            return _meet_box(origins, directions, origins.new_tensor(half))
        case Sphere(radius=radius):
            return _meet_ball(origins, directions, radius)
        case Capsule(radius=radius, half_length=half):
            end = origins.new_tensor([0.0, 0.0, half])
            ends = (_meet_ball(origins + sign * end, directions, radius) for sign in (-1.0, 1.0))
            side = _meet_ball(origins, directions, radius, around_axis=True)
            within = (origins + side.nan_to_num(posinf=0.0)[..., None] * directions)[..., 2].abs() <= half
            return torch.minimum(torch.minimum(*ends), torch.where(within, side, torch.inf))
        case _:
            along = -origins[..., 2] / directions[..., 2]
            return torch.where((directions[..., 2] < 0.0) & (along >= 0.0), along, torch.inf)


def _meet_box(origins: Tensor, directions: Tensor, half: Tensor) -> Tensor:
    inverse = 1.0 / torch.where(directions == 0.0, 1e-30, directions)
    one, other = (-half - origins) * inverse, (half - origins) * inverse
    enter, leave = torch.minimum(one, other).amax(-1), torch.maximum(one, other).amin(-1)
    return torch.where((enter <= leave) & (enter >= 0.0), enter, torch.inf)


def _meet_ball(origins: Tensor, directions: Tensor, radius: float, around_axis: bool = False) -> Tensor:
    """A ball, or where ``around_axis`` an endless cylinder about z."""
    axes = slice(0, 2) if around_axis else slice(0, 3)
    o, d = origins[..., axes], directions[..., axes]
    a, b, c = (d * d).sum(-1), (o * d).sum(-1), (o * o).sum(-1) - radius**2
    root = b * b - a * c
    along = (-b - root.clamp_min(0.0).sqrt()) / a.clamp_min(1e-30)
    return torch.where((root >= 0.0) & (along >= 0.0) & (a > 0.0), along, torch.inf)
