"""Surface of a liquid in a picture: spheres around its particles, whose depths are smoothed.

Depths are smoothed by the filter of Truong and Yuksel, "A narrow-range filter for screen-space fluid rendering", 2018,
along rows and columns in turn. All is of a fixed size, so that a step that draws is captured as any other.
"""

# pyright: reportIndexIssue=false, reportArgumentType=false, reportCallIssue=false, reportOperatorIssue=false
# pyright: reportAssignmentType=false, reportGeneralTypeIssues=false, reportAttributeAccessIssue=false
# pyright: reportReturnType=false
# ruff: noqa: UP018 - float() makes variables that a kernel's loops may change.

from __future__ import annotations

import torch
import warp as wp
from torch import Tensor

from orbit_core.scene import CameraSpec
from orbit_matter.lens import Lens, from_view, lens_of, pixel_of, ray_of, seen
from orbit_warpkit.graphs import Graphs

RADIUS = 0.75
"""Spacings of a sphere: those of a full grid overlap, and stand no further out of a liquid than thin walls hide."""
REACH = 3.5
"""Spacings over which depths are smoothed."""
NARROW = wp.constant(2.0)
"""Spacings by which depths differ that are not smoothed into each other."""
MOST = wp.constant(24)
"""Pixels of the filter to each side, near the camera."""
ROUNDS = 3
"""Times that rows and columns are smoothed."""


@wp.kernel(enable_backward=False)
def splat(points: wp.array2d[wp.vec3], poses: wp.array2d[float], lens: Lens, radius: float, depths: wp.array3d[float]):
    """Draw the nearest sphere along each pixel's ray."""
    env, i = wp.tid()
    p = seen(poses, env, points[env, i])
    if not p[2] - radius > lens.near:
        return
    middle, wide = pixel_of(lens, p), lens.focal * radius / (p[2] - radius) + 1.0
    for row in range(wp.max(int(middle[1] - wide), 0), wp.min(int(middle[1] + wide), lens.height - 1) + 1):
        for column in range(wp.max(int(middle[0] - wide), 0), wp.min(int(middle[0] + wide), lens.width - 1) + 1):
            # From where the ray is as deep as the middle: squares of the whole way would drown a radius far away.
            ray = ray_of(lens, column, row)
            away, length = p - ray * p[2], wp.length_sq(ray)
            along = wp.dot(ray, away)
            root = along * along - length * (wp.length_sq(away) - radius * radius)
            if root >= 0.0:
                depth = p[2] + (along - wp.sqrt(root)) / length
                if depth < lens.far:
                    wp.atomic_min(depths, env, row, column, depth)


@wp.kernel(enable_backward=False)
def smooth(before: wp.array3d[float], lens: Lens, spacing: float, reach: float, down: int, after: wp.array3d[float]):
    """Smooth depths along rows, or ``down`` columns."""
    env, row, column = wp.tid()
    here = before[env, row, column]
    after[env, row, column] = here
    if here == wp.inf:
        return
    wide = wp.clamp(int(reach * lens.focal / here), 1, MOST)
    total, weights = float(here), float(1.0)
    for k in range(1, wide + 1):
        up, left = row - k * down, column - k * (1 - down)
        low, right = row + k * down, column + k * (1 - down)
        if up >= 0 and left >= 0 and low < lens.height and right < lens.width:
            one, two = before[env, up, left], before[env, low, right]
            # In pairs: at the edge of a slanted surface one side alone would draw it out through the wall before it.
            if wp.abs(one - here) < NARROW * spacing and wp.abs(two - here) < NARROW * spacing:
                share = float(k) / float(wide)
                weight = wp.exp(-2.0 * share * share)
                total += weight * (one + two)
                weights += 2.0 * weight
    after[env, row, column] = total / weights


@wp.func
def slope(at: wp.vec3, before: wp.vec3, after: wp.vec3, most: float) -> wp.vec3:
    """Return the way along the surface to a neighbouring pixel, on the side that is less steep."""
    back, on = at - before, after - at
    if wp.abs(back[2]) < wp.abs(on[2]):
        on = back
    if not wp.abs(on[2]) < most:
        # A lone pixel has no neighbours; it faces the camera.
        on = wp.vec3(on[0], on[1], 0.0)
    return on


@wp.kernel(enable_backward=False)
def bend(depths: wp.array3d[float], poses: wp.array2d[float], lens: Lens, spacing: float, bent: wp.array3d[wp.vec3]):
    """Find the normals of a surface from its depths."""
    env, row, column = wp.tid()
    here = depths[env, row, column]
    if here == wp.inf:
        return
    left, right = wp.max(column - 1, 0), wp.min(column + 1, lens.width - 1)
    above, below = wp.max(row - 1, 0), wp.min(row + 1, lens.height - 1)
    at, most = ray_of(lens, column, row) * here, 2.0 * spacing
    # Without a depth of their own neighbours are far away, and not taken.
    x = slope(
        at,
        ray_of(lens, column - 1, row) * wp.min(depths[env, row, left], 1.0e6),
        ray_of(lens, column + 1, row) * wp.min(depths[env, row, right], 1.0e6),
        most,
    )
    y = slope(
        at,
        ray_of(lens, column, row - 1) * wp.min(depths[env, above, column], 1.0e6),
        ray_of(lens, column, row + 1) * wp.min(depths[env, below, column], 1.0e6),
        most,
    )
    # x to the right and y down: their product points away from the camera.
    bent[env, row, column] = -wp.normalize(from_view(poses, env, wp.cross(x, y)))


def depths(graphs: Graphs, camera: CameraSpec, poses: Tensor, points: Tensor, spacing: float) -> Tensor:
    """Return depths (n, H, W) of spheres around points (n, P, 3), infinite next to them."""
    drawn = torch.full((len(points), camera.height, camera.width), torch.inf, device=points.device)
    given = [wp.from_torch(points.contiguous(), wp.vec3), wp.from_torch(poses.contiguous().float()), lens_of(camera)]
    with graphs.stream():
        wp.launch(splat, points.shape[:2], inputs=[*given, RADIUS * spacing, wp.from_torch(drawn)])
    return drawn


def surface(graphs: Graphs, camera: CameraSpec, poses: Tensor, points: Tensor, spacing: float) -> tuple[Tensor, Tensor]:
    """Return depths (n, H, W), infinite next to the liquid, and normals (n, H, W, 3) of its surface."""
    rough = depths(graphs, camera, poses, points, spacing)
    other, normals, lens = torch.empty_like(rough), torch.zeros(*rough.shape, 3, device=rough.device), lens_of(camera)
    eyes = wp.from_torch(poses.contiguous().float())
    one, two, bent = wp.from_torch(rough), wp.from_torch(other), wp.from_torch(normals, wp.vec3)
    with graphs.stream():
        for _ in range(ROUNDS):
            wp.launch(smooth, rough.shape, inputs=[one, lens, spacing, REACH * spacing, 0, two])
            wp.launch(smooth, rough.shape, inputs=[two, lens, spacing, REACH * spacing, 1, one])
        wp.launch(bend, rough.shape, inputs=[one, eyes, lens, spacing, bent])
    return rough, normals
