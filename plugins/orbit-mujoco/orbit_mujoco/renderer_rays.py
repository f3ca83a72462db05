"""Depth, geoms and exact normals by a ray through each pixel's centre."""

# pyright: reportAttributeAccessIssue=false

from __future__ import annotations

import math
from functools import lru_cache
from typing import Any

import mujoco
import numpy as np
import numpy.typing as npt

from orbit_core.scene import CameraSpec, Sky
from orbit_mujoco.renderer_model import quaternion_matrix

_Array = npt.NDArray[Any]
HIDDEN_GROUP = 5
"""The group of geoms that is not drawn."""
_SEEN_GROUPS = np.array([group < HIDDEN_GROUP for group in range(6)], dtype=np.uint8)


def trace(
    model: mujoco.MjModel,
    data: mujoco.MjData,
    camera: CameraSpec,
    pose: npt.NDArray[np.float64],
    depth: _Array,
    normals: _Array,
    geoms: _Array,
) -> None:
    """Fill depth (H, W, 1) in metres along the optical axis, normals (H, W, 3) in world axes, geoms (H, W, 1).

    Where there is nothing within the camera's range, depth is infinite, the normal zero and the geom -1.
    """
    rays = _pixel_rays(camera.width, camera.height, camera.vertical_fov)
    lengths = np.linalg.norm(rays, axis=-1)
    count = len(rays)
    hit_geoms, distances, hit_normals = np.empty(count, np.int32), np.empty(count), np.empty((count, 3))
    directions = (rays / lengths[:, None]) @ quaternion_matrix(pose[3:]).T
    reach = camera.far * float(lengths.max())
    mujoco.mj_multiRay(
        model,
        data,
        pose[:3],
        directions.ravel(),
        _SEEN_GROUPS,
        True,
        -1,
        hit_geoms,
        distances,
        hit_normals.ravel(),
        count,
        reach,
    )
    z = distances / lengths
    nothing = (hit_geoms < 0) | (z > camera.far) | (z < camera.near)
    depth[...] = np.where(nothing, np.inf, z).reshape(depth.shape)
    normals[...] = np.where(nothing[:, None], 0.0, hit_normals).reshape(normals.shape)
    geoms[...] = np.where(nothing, -1, hit_geoms).reshape(geoms.shape)


def sky_colors(
    sky: Sky, camera: CameraSpec, pose: npt.NDArray[np.float64], where: npt.NDArray[np.bool_]
) -> npt.NDArray[np.uint8]:
    """(P, 3) what the camera sees of the sky at its pixels ``where`` (H, W)."""
    rays = _pixel_rays(camera.width, camera.height, camera.vertical_fov)[where.ravel()]
    height = (rays @ quaternion_matrix(pose[3:])[2]) / np.linalg.norm(rays, axis=-1)
    above, below = np.asarray(sky.above), np.asarray(sky.below)
    return (255.0 * (below + 0.5 * (1.0 + height[:, None]) * (above - below)) + 0.5).astype(np.uint8)


@lru_cache(maxsize=16)
def _pixel_rays(width: int, height: int, vertical_fov: float) -> npt.NDArray[np.floating]:
    """(H W, 3) vectors from the camera to its pixels' centres at depth 1, row after row from the top."""
    pixel = 2.0 * math.tan(0.5 * vertical_fov) / height
    x = (np.arange(width) + 0.5 - width / 2) * pixel
    y = (height / 2 - np.arange(height) - 0.5) * pixel
    grid_x, grid_y = np.meshgrid(x, y)
    return np.stack((grid_x, grid_y, -np.ones_like(grid_x)), -1).reshape(-1, 3)
