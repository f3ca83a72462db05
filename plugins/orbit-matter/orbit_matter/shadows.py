"""Shadows that deformables cast and receive, from maps of what each light meets first."""

# pyright: reportIndexIssue=false, reportArgumentType=false, reportCallIssue=false, reportOperatorIssue=false
# pyright: reportAssignmentType=false, reportGeneralTypeIssues=false, reportAttributeAccessIssue=false
# pyright: reportReturnType=false
# ruff: noqa: UP018 - float() makes variables that a kernel's loops may change.

from __future__ import annotations

from dataclasses import dataclass

import warp as wp
from torch import Tensor

from orbit_core.scene import CameraSpec
from orbit_matter.lens import Lens, from_view, lens_of, pixel_of, ray_of, seen
from orbit_warpkit.graphs import Graphs

BIAS = wp.constant(1.5)
"""Pixels of the map by which a surface is nearer to the light that shades another."""
OFFSET = wp.constant(2.5)
"""Pixels of the map by which points are taken in front of their surface, or one along the light would shade itself."""


@dataclass(frozen=True, eq=False)
class DepthMap:
    """Depths (n, H, W) of what a directional light meets first."""

    light: int
    """Index among the scene's directional lights."""
    camera: CameraSpec
    """Lens of the light's camera."""
    poses: Tensor
    """(n, 7) of the light's camera."""
    depths: Tensor
    """(n, H, W) m, infinite where nothing is met."""


@wp.kernel(enable_backward=False)
def shade(
    depths: wp.array3d[float],
    normals: wp.array3d[wp.vec3],
    poses: wp.array2d[float],
    lens: Lens,
    nearest: wp.array3d[float],
    sources: wp.array2d[float],
    light: Lens,
    index: int,
    reached: wp.array4d[float],
):
    """Find the part of a light that reaches each pixel, from nine pixels of its map."""
    env, row, column = wp.tid()
    depth = depths[env, row, column]
    if depth == wp.inf:
        return
    eye = wp.vec3(poses[env, 0], poses[env, 1], poses[env, 2])
    point = eye + from_view(poses, env, ray_of(lens, column, row) * depth)
    pixel = seen(sources, env, point)[2] / light.focal
    p = seen(sources, env, point + normals[env, row, column] * (OFFSET * pixel))
    at = pixel_of(light, p)
    c, r = int(wp.floor(at[0])), int(wp.floor(at[1]))
    if c < 1 or r < 1 or c >= light.width - 1 or r >= light.height - 1:
        return
    before, free = p[2] - BIAS * pixel, float(0.0)
    for i in range(-1, 2):
        for j in range(-1, 2):
            if not nearest[env, r + i, c + j] < before:
                free += 1.0 / 9.0
    reached[env, row, column, index] = wp.min(free, 1.0)


def cast(
    graphs: Graphs,
    camera: CameraSpec,
    poses: Tensor,
    depth: Tensor,
    normals: Tensor,
    source: DepthMap,
    reached: Tensor,
) -> None:
    """Write the part of a light that reaches a surface.

    Args:
        graphs: of the device.
        camera: that sees the surface.
        poses: (n, 7) of the camera.
        depth: (n, H, W) m of the surface.
        normals: (n, H, W, 3) of the surface.
        source: what the light meets first.
        reached: (n, H, W, K), whose element of that light is written.
    """
    picture = [wp.from_torch(depth.contiguous()), wp.from_torch(normals.contiguous(), wp.vec3)]
    eyes = [wp.from_torch(poses.contiguous().float()), lens_of(camera)]
    given = [wp.from_torch(source.depths), wp.from_torch(source.poses.contiguous().float()), lens_of(source.camera)]
    with graphs.stream():
        wp.launch(shade, depth.shape, inputs=[*picture, *eyes, *given, source.light, wp.from_torch(reached)])
