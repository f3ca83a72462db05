"""Points from depth images, and directions of pixels."""

from __future__ import annotations

import math

import torch
from torch import Tensor

from orbit_core.dynamics.transforms import transform_points
from orbit_core.scene import CameraSpec


def intrinsic_matrix(camera: CameraSpec) -> Tensor:
    """(3, 3) pinhole matrix in pixels: u to the right and v down from the image's top left corner.

    Pixel (row, column) has its centre at ``(u, v) = (column + 0.5, row + 0.5)``; pixels are square.
    """
    focal = 0.5 * camera.height / math.tan(0.5 * camera.vertical_fov)
    return torch.tensor([[focal, 0.0, camera.width / 2], [0.0, focal, camera.height / 2], [0.0, 0.0, 1.0]])


def point_cloud(depth: Tensor, intrinsics: Tensor, pose: Tensor | None = None) -> Tensor:
    """Points (n, H, W, 3) of depth images (n, H, W, 1), infinite where nothing was seen.

    In the camera's frame (-z forward, y up), or in the environment's where the camera's ``pose`` (n, 7) is given.
    """
    height, width = depth.shape[1:3]
    column = torch.arange(width, device=depth.device) + 0.5
    row = torch.arange(height, device=depth.device) + 0.5
    x = ((column - intrinsics[0, 2]) / intrinsics[0, 0]).expand(height, width)
    y = ((row - intrinsics[1, 2]) / intrinsics[1, 1])[:, None].expand(height, width)
    seen = depth.isfinite()
    points = torch.stack((x, -y, -torch.ones_like(x)), -1) * torch.where(seen, depth, 0.0)
    if pose is not None:
        points = transform_points(pose[:, None, None], points)
    return torch.where(seen, points, torch.inf)


def project(points: Tensor, intrinsics: Tensor) -> Tensor:
    """Pixel coordinates (..., 2), u then v, of points (..., 3) in the camera's frame (-z forward, y up)."""
    depth = -points[..., 2]
    u = intrinsics[0, 0] * points[..., 0] / depth + intrinsics[0, 2]
    v = -intrinsics[1, 1] * points[..., 1] / depth + intrinsics[1, 2]
    return torch.stack((u, v), -1)
