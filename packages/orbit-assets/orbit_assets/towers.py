"""Towers of blocks, three a layer, each layer across the one below."""

from __future__ import annotations

import math

import torch
from torch import Tensor

from orbit_core.dynamics.transforms import quat_from_rotation_vector, quat_multiply, quat_rotate
from orbit_core.scene.pose import Pose, Vector3

SIZE: Vector3 = (0.12, 0.0395, 0.024)
"""Metres: length, width and height of a block; every gripper of the catalogue opens wider than its width."""
PITCH = 0.04
"""Metres between the middles of two blocks of a layer."""


def cell_poses(foot: Tensor, cells: Tensor, layers: int) -> Tensor:
    """Poses (n, k, 7) of blocks in cells of towers.

    Args:
        foot: (n, 7) the middle of the towers' undersides. A block on top of the highest layer would lie along its x.
        cells: (n, k) int64, numbered from the lowest layer, three a layer, along the layer's pitch.
        layers: of the whole tower.
    """
    layer, slot = cells // 3, cells % 3
    crossing = ((layer - layers) % 2).to(foot.dtype)
    aside = (slot - 1) * PITCH
    local = torch.stack((crossing * aside, (1.0 - crossing) * aside, SIZE[2] * (layer + 0.5)), dim=-1)
    turn = torch.zeros_like(local)
    turn[..., 2] = 0.5 * math.pi * crossing
    standing = foot[:, None].expand(*cells.shape, 7)
    position = standing[..., :3] + quat_rotate(standing[..., 3:], local)
    return torch.cat((position, quat_multiply(standing[..., 3:], quat_from_rotation_vector(turn))), dim=-1)


def tower(foot: Vector3, layers: int) -> list[Pose]:
    """Poses of all blocks of a tower, from the lowest layer, where ``foot`` is the middle of its underside."""
    cells = torch.arange(3 * layers)[None]
    poses = cell_poses(torch.tensor([[*foot, 1.0, 0.0, 0.0, 0.0]]), cells, layers)[0].tolist()
    return [Pose((x, y, z), (qw, qx, qy, qz)) for x, y, z, qw, qx, qy, qz in poses]
