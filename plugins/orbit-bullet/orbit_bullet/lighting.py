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


# Bullet's OpenGL shades a surface of albedo a, in the light of a direction at a cosine c, as a (0.75 + 0.25 c) where it
# faces the light and a (0.675 + 0.175 c) where it does not, and adds a highlight in front that no setting changes.
_FRONT, _BACK = (0.75, 0.25), (0.675, 0.175)


def textured_albedo(one: _Array, other: _Array) -> npt.NDArray[np.float32]:
    """Return the albedo (H, W, 3) of 255 of surfaces in OpenGL's pictures from a light and from the opposite one."""
    bright, dark = np.maximum(one, other).astype(np.float32), np.minimum(one, other).astype(np.float32)
    # The cosine cancels out.
    ratio = _FRONT[1] / _BACK[1]
    return ((bright + ratio * dark) / (_FRONT[0] + ratio * _BACK[0])).astype(np.float32)


def facing_pair(lit: _Array, opposite: _Array, albedo: _Array) -> npt.NDArray[np.float32]:
    """Return (H, W, 3) albedo times the cosine to a light, from OpenGL's pictures in it and in the opposite one."""
    cosines = (_BACK[0] - opposite / np.maximum(albedo, 1.0)) / _BACK[1]
    return np.where(lit >= opposite, albedo * np.clip(cosines, 0.0, 1.0), 0.0).astype(np.float32)


def facing_once(lit: _Array, albedo: _Array) -> npt.NDArray[np.float32]:
    """Return (H, W, 3) albedo times the cosine to a light, from OpenGL's picture in it alone."""
    cosines = (lit / np.maximum(albedo, 1.0) - _FRONT[0]) / _FRONT[1]
    return (albedo * np.clip(cosines, 0.0, 1.0)).astype(np.float32)


def add_light(colors: _Array, facing: _Array, radiance: npt.ArrayLike, reached: _Array | None) -> None:
    """Add to colours (H, W, 3) of 255 what a light gives surfaces.

    Args:
        colors: written in place.
        facing: (H, W, 3) albedo times the cosine between surface and a white light; Bullet rounds whole numbers down.
        radiance: of the light.
        reached: (H, W) whether the light meets the surface; None where it meets all.
    """
    whole = np.issubdtype(facing.dtype, np.integer)
    part = (np.where(facing > 0, facing + np.float32(0.5), np.float32(0.0)) if whole else facing) * np.asarray(
        radiance, np.float32
    )
    colors += part if reached is None else part * reached[..., None]
