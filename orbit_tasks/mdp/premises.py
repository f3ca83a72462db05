"""Functions of which tasks make their premises."""

from __future__ import annotations

from collections.abc import Sequence

import torch
from torch import Tensor
from torch.linalg import vector_norm

from orbit_core.dynamics.transforms import quat_rotate
from orbit_core.interfaces import World

# m/s: what is slower, and turns slower than ten times that in rad/s, is still.
SPEED = 0.02
# rad by which what stands upright may lean.
TILT = 0.05
# Metres by which what stands may be higher or lower than it should: engines let things sink in, or float.
HEIGHT = 0.003


def still(world: World, names: Sequence[str], speed: float = SPEED) -> Tensor:
    """(N,) bool: all of these objects move slower than ``speed`` (m/s), and turn slower than ten times that (rad/s)."""
    velocities = torch.stack([world.objects[name].root_velocity for name in names], dim=1)
    fast = vector_norm(velocities[..., :3], dim=-1).maximum(0.1 * vector_norm(velocities[..., 3:], dim=-1))
    return (fast < speed).all(1)


def upright(world: World, names: Sequence[str], tilt: float = TILT) -> Tensor:
    """(N,) bool: the z axes of all of these objects are within ``tilt`` (rad) of the vertical."""
    orientations = torch.stack([world.objects[name].root_pose[:, 3:] for name in names], dim=1)
    vertical = torch.eye(3, device=world.device)[2].expand(*orientations.shape[:-1], 3)
    axes = quat_rotate(orientations, vertical)
    return (vector_norm(axes - vertical, dim=-1) < tilt).all(1)


def standing(world: World, names: Sequence[str], height: float) -> Tensor:
    """(N,) bool: all of these objects are still and upright, their origins within 3 mm of ``height`` (m)."""
    heights = torch.stack([world.objects[name].root_pose[:, 2] for name in names], dim=1)
    level = ((heights - height).abs() < HEIGHT).all(1)
    return level & still(world, names) & upright(world, names)
