"""Surface normals from depth images: the cross product of the differences to neighbouring pixels."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from orbit_bullet.lighting import pixel_rays
from orbit_core.plugin_kit.rotations import cross, rotate
from orbit_core.scene import CameraSpec

_Array = npt.NDArray[Any]
# Cost of a neighbour without a further one that shows how flat it is, in 1/m.
_LONE = 1e3


def normals_of(depth: _Array, seen: _Array, camera: CameraSpec, poses: _Array) -> _Array:
    """Unit normals (n, H, W, 3) in world axes of depth (n, H, W, 1), towards the camera.

    Of the two sides along an image axis that show the same link, the flatter counts: a difference over an edge would
    be that of two faces. Inverse depth is linear over a flat face. Where nothing is seen, zero.
    """
    finite = np.isfinite(depth)
    points = _points(np.where(finite, depth, 0.0), camera)
    across, down = (_difference(points, depth[..., 0], seen[..., 0], axis) for axis in (2, 1))
    normals = cross(down, across)  # rows grow downwards
    lengths = np.linalg.norm(normals, axis=-1, keepdims=True)
    normals = np.divide(normals, lengths, out=np.zeros_like(normals), where=lengths > 0)
    facing = np.where((normals * points).sum(-1, keepdims=True) > 0, -1.0, 1.0)
    world = rotate(poses[:, None, None, 3:], normals * facing)
    return np.where(finite, world, 0.0).astype(np.float32)


def _points(depth: _Array, camera: CameraSpec) -> _Array:
    """Points in the camera's frame, which looks along -z."""
    return depth.astype(np.float64) * pixel_rays(camera)


def _difference(points: _Array, depth: _Array, seen: _Array, axis: int) -> _Array:
    """Difference to the better neighbour along an axis."""
    inverse = np.divide(1.0, depth, out=np.zeros(depth.shape), where=np.isfinite(depth) & (depth > 0))
    best, least = np.zeros_like(points), np.full(depth.shape, np.inf)
    for step in (1, -1):
        next_point, next_inverse, next_link = (np.roll(values, -step, axis) for values in (points, inverse, seen))
        after_inverse, after_link = (np.roll(values, -2 * step, axis) for values in (inverse, seen))
        bend = np.abs(after_inverse - 2 * next_inverse + inverse)
        straight = np.abs(next_inverse - inverse) + _LONE
        cost = np.where((after_link == seen) & ~_border(seen, axis, step, 2), bend, straight)
        cost[(next_link != seen) | _border(seen, axis, step, 1)] = np.inf
        better = cost < least
        least = np.where(better, cost, least)
        best = np.where(better[..., None], step * (next_point - points), best)
    return best


def _border(image: _Array, axis: int, step: int, width: int) -> npt.NDArray[np.bool_]:
    """The pixels whose neighbours at ``width`` steps lie outside."""
    outside = np.zeros(image.shape, dtype=bool)
    rows: list[slice] = [slice(None)] * image.ndim
    rows[axis] = slice(-width, None) if step == 1 else slice(0, width)
    outside[tuple(rows)] = True
    return outside
