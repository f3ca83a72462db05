"""Colours of a picture from what its pixels show: albedo, light and sky."""

from __future__ import annotations

import math
from functools import lru_cache
from typing import Any

import numpy as np
import numpy.typing as npt

from orbit_core.scene import CameraSpec, Sky

_Array = npt.NDArray[Any]


@lru_cache(maxsize=16)
def pixel_rays(camera: CameraSpec) -> npt.NDArray[np.float64]:
    """(H, W, 3) from the camera to its pixels' centres at depth 1, in its own frame."""
    half = math.tan(camera.vertical_fov / 2)
    y = half * (1 - (2 * np.arange(camera.height) + 1) / camera.height)
    x = half * ((2 * np.arange(camera.width) + 1) / camera.width - 1) * camera.width / camera.height
    return np.stack((*np.meshgrid(x, y), -np.ones((camera.height, camera.width))), -1)


def sky_colors(sky: Sky, rays: _Array, rotation: _Array) -> _Array:
    """(P, 3) of 255, along rays (P, 3) of a camera that is turned by ``rotation`` (3, 3)."""
    height = (rays @ rotation[2]) / np.linalg.norm(rays, axis=-1)
    above, below = np.asarray(sky.above), np.asarray(sky.below)
    return 255.0 * (below + 0.5 * (1.0 + height[:, None]) * (above - below))


def add_light(colors: _Array, facing: npt.NDArray[np.uint8], radiance: npt.ArrayLike, reached: _Array | None) -> None:
    """Add to colours (H, W, 3) of 255 what a light gives surfaces.

    Args:
        colors: written in place.
        facing: (H, W, 3) albedo times the cosine between surface and a white light, which Bullet has rounded down.
        radiance: of the light.
        reached: (H, W) whether the light meets the surface; None where it meets all.
    """
    part = np.where(facing > 0, facing + np.float32(0.5), np.float32(0.0)) * np.asarray(radiance, np.float32)
    colors += part if reached is None else part * reached[..., None]
