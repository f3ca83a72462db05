"""Deformables painted into the pictures of any renderer: drawn in Warp, shaded as the scene's light says.

Triangles are rasterised, liquids are drawn in screen space (:mod:`orbit_matter.splats`), shadows come from a map for
each light (:mod:`orbit_matter.shadows`).
"""

# pyright: reportIndexIssue=false, reportArgumentType=false, reportCallIssue=false, reportOperatorIssue=false
# pyright: reportAssignmentType=false, reportGeneralTypeIssues=false, reportAttributeAccessIssue=false
# pyright: reportReturnType=false

# Kernels are compiled by Warp; to Python they are annotations and calls that no type checker can follow.

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import torch
import warp as wp
from torch import Tensor

from orbit_core.interfaces import Image, LightTable, SceneLayout
from orbit_core.interfaces.matter import LightView, MatterPainter
from orbit_core.plugin_kit.rendering import DeformableSurface
from orbit_core.scene import CameraSpec, Fluid
from orbit_matter import shadows, splats
from orbit_matter.lens import Lens, lens_of, pixel_of, seen
from orbit_warpkit.graphs import Graphs
from orbit_warpkit.start import start

_NOTHING = 2**62
NOTHING = wp.constant(wp.int64(_NOTHING))
"""The key of a pixel that no triangle covers."""
TICKS = wp.constant(1.0e5)
"""Per metre of depth, in which surfaces are told apart."""
SHIFT = wp.constant(wp.int64(2**24))
"""Above the number of a triangle in a pixel's key stands its depth."""


@wp.func
def shares(a: wp.vec2, b: wp.vec2, c: wp.vec2, p: wp.vec2) -> wp.vec3:
    """Return barycentric coordinates in the picture."""
    area = (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])
    # Seen edge-on, a triangle covers no pixel.
    if wp.abs(area) < 1.0e-9:
        return wp.vec3(-1.0, -1.0, -1.0)
    u = ((b[0] - p[0]) * (c[1] - p[1]) - (b[1] - p[1]) * (c[0] - p[0])) / area
    v = ((c[0] - p[0]) * (a[1] - p[1]) - (c[1] - p[1]) * (a[0] - p[0])) / area
    return wp.vec3(u, v, 1.0 - u - v)


@wp.kernel(enable_backward=False)
def rasterise(
    points: wp.array2d[wp.vec3],
    faces: wp.array2d[int],
    poses: wp.array2d[float],
    lens: Lens,
    keys: wp.array3d[wp.int64],
):
    """The nearest triangle of each pixel's centre, by depth and then by number."""
    env, face = wp.tid()
    a = seen(poses, env, points[env, faces[face, 0]])
    b = seen(poses, env, points[env, faces[face, 1]])
    c = seen(poses, env, points[env, faces[face, 2]])
    # A triangle across the near plane would have to be clipped; it is left out whole.
    if wp.min(a[2], wp.min(b[2], c[2])) < lens.near:
        return
    pa, pb, pc = pixel_of(lens, a), pixel_of(lens, b), pixel_of(lens, c)
    left = wp.max(int(wp.floor(wp.min(pa[0], wp.min(pb[0], pc[0])))), 0)
    right = wp.min(int(wp.ceil(wp.max(pa[0], wp.max(pb[0], pc[0])))), lens.width - 1)
    top = wp.max(int(wp.floor(wp.min(pa[1], wp.min(pb[1], pc[1])))), 0)
    bottom = wp.min(int(wp.ceil(wp.max(pa[1], wp.max(pb[1], pc[1])))), lens.height - 1)
    for row in range(top, bottom + 1):
        for column in range(left, right + 1):
            s = shares(pa, pb, pc, wp.vec2(float(column) + 0.5, float(row) + 0.5))
            if s[0] >= 0.0 and s[1] >= 0.0 and s[2] >= 0.0:
                depth = 1.0 / (s[0] / a[2] + s[1] / b[2] + s[2] / c[2])
                if depth < lens.far:
                    # Depth first, then the number: one atomic minimum finds the nearest triangle, the same in every
                    # run.
                    key = wp.int64(depth * TICKS) * SHIFT + wp.int64(face)
                    wp.atomic_min(keys, env, row, column, key)


@wp.kernel(enable_backward=False)
def resolve(
    points: wp.array2d[wp.vec3],
    normals: wp.array2d[wp.vec3],
    faces: wp.array2d[int],
    poses: wp.array2d[float],
    lens: Lens,
    keys: wp.array3d[wp.int64],
    depths: wp.array3d[float],
    bent: wp.array3d[wp.vec3],
):
    """Depth and normal of each pixel's triangle, the normal towards the camera."""
    env, row, column = wp.tid()
    if keys[env, row, column] == NOTHING:
        return
    face = int(keys[env, row, column] % SHIFT)
    i, j, k = faces[face, 0], faces[face, 1], faces[face, 2]
    a, b, c = seen(poses, env, points[env, i]), seen(poses, env, points[env, j]), seen(poses, env, points[env, k])
    p = wp.vec2(float(column) + 0.5, float(row) + 0.5)
    s = shares(pixel_of(lens, a), pixel_of(lens, b), pixel_of(lens, c), p)
    depth = 1.0 / (s[0] / a[2] + s[1] / b[2] + s[2] / c[2])
    weights = wp.vec3(s[0] * depth / a[2], s[1] * depth / b[2], s[2] * depth / c[2])
    n = normals[env, i] * weights[0] + normals[env, j] * weights[1] + normals[env, k] * weights[2]
    eye = wp.vec3(poses[env, 0], poses[env, 1], poses[env, 2])
    n = wp.normalize(n)
    # Cloth has two sides, and both are lit.
    if wp.dot(n, points[env, i] - eye) > 0.0:
        n = -n
    depths[env, row, column] = depth
    bent[env, row, column] = n


class Painter(MatterPainter):
    """Paints all deformables of a scene, opaque ones first, and the shadows that they cast and receive."""

    def __init__(self, layout: SceneLayout, device: torch.device) -> None:
        start()
        self._scene, self._first, self._device = layout.scene, len(layout.links), device
        self._graphs = Graphs(device, capture=False)
        specs = layout.scene.deformables
        faces = [DeformableSurface(spec).faces for spec in specs]
        self._corners = [torch.as_tensor(each, dtype=torch.int64, device=device) for each in faces]
        with wp.ScopedDevice(self._graphs.device):
            self._faces = [wp.array(np.asarray(each, np.int32), dtype=int, ndim=2) for each in faces]
        self._lamps = len(layout.scene.directional_lights)
        self._order = sorted(range(len(specs)), key=lambda index: specs[index].color[3] < 1.0)
        self._colors = torch.tensor([spec.color[:3] for spec in specs], dtype=torch.float32, device=device)

    def paint(
        self,
        camera: CameraSpec,
        camera_poses: Tensor,
        vertices: Sequence[Tensor],
        image: Image,
        lights: LightTable,
        views: Sequence[LightView] = (),
    ) -> Image:
        of_matter = [self._map_of(view, vertices) for view in views]
        image = self._darken(camera, camera_poses, image, lights, of_matter)
        # Renderers shade other things by each other; deformables are shaded here, by everything.
        of_all = [
            replace(each, depths=torch.minimum(each.depths, view.depth[..., 0]))
            for each, view in zip(of_matter, views, strict=True)
        ]
        for index in self._order:
            depth, normals = self._draw(camera, camera_poses, vertices[index], index)
            reached = self._reached(camera, camera_poses, depth, normals, of_all)
            image = self._over(image, index, depth, normals, _light(lights, normals, reached))
        return image

    def _map_of(self, view: LightView, vertices: Sequence[Tensor]) -> shadows.DepthMap:
        nearest = torch.full_like(view.depth[..., 0], torch.inf)
        for index, points in enumerate(vertices):
            spec = self._scene.deformables[index]
            if isinstance(spec, Fluid):
                # Spheres are rough: a liquid does not shade its own surface.
                depth = splats.depths(self._graphs, view.camera, view.poses, points, spec.spacing) + spec.spacing
            else:
                depth = self._rasterised(view.camera, view.poses, points, index)[0]
            nearest = torch.minimum(nearest, depth)
        return shadows.DepthMap(view.light, view.camera, view.poses, nearest)

    def _darken(
        self,
        camera: CameraSpec,
        poses: Tensor,
        image: Image,
        lights: LightTable,
        maps: Sequence[shadows.DepthMap],
    ) -> Image:
        """Return the image with the shadows of deformables on what it shows."""
        if not maps:
            return image
        assert image.rgb is not None  # the core asks for these with shadows
        assert image.depth is not None
        assert image.normals is not None
        assert image.albedo is not None
        reached = self._reached(camera, poses, image.depth[..., 0], image.normals, maps)
        lit = image.albedo * _light(lights, image.normals, reached) + 0.5
        # Not lighter than it was: what other things shade stays dark.
        dark = torch.minimum(lit.clamp(0.0, 255.0).to(image.rgb.dtype), image.rgb)
        shaded = (reached < 1.0).any(-1, keepdim=True)
        return replace(image, rgb=torch.where(shaded, dark, image.rgb))

    def _reached(
        self, camera: CameraSpec, poses: Tensor, depth: Tensor, normals: Tensor, maps: Sequence[shadows.DepthMap]
    ) -> Tensor:
        """(n, H, W, K) in [0, 1] of each directional light that reaches a surface (n, H, W)."""
        reached = torch.ones(*depth.shape, self._lamps, device=self._device)
        for each in maps:
            shadows.cast(self._graphs, camera, poses, depth, normals, each, reached)
        return reached

    def _draw(self, camera: CameraSpec, poses: Tensor, points: Tensor, index: int) -> tuple[Tensor, Tensor]:
        """Depth (n, H, W), infinite next to it, and normals (n, H, W, 3) of one deformable."""
        spec = self._scene.deformables[index]
        if isinstance(spec, Fluid):
            return splats.surface(self._graphs, camera, poses, points, spec.spacing)
        return self._rasterised(camera, poses, points, index)

    def _rasterised(self, camera: CameraSpec, poses: Tensor, points: Tensor, index: int) -> tuple[Tensor, Tensor]:
        shape = (len(points), camera.height, camera.width)
        keys = torch.full(shape, _NOTHING, dtype=torch.int64, device=self._device)
        depth = torch.full(shape, torch.inf, device=self._device)
        bent = torch.zeros(*shape, 3, device=self._device)
        points = points.contiguous()
        normals = self._normals(points, index)
        faces, eyes, lens = self._faces[index], wp.from_torch(poses.contiguous().float()), lens_of(camera)
        corners = [wp.from_torch(points, wp.vec3), faces, eyes, lens, wp.from_torch(keys)]
        with self._graphs.stream():
            wp.launch(rasterise, (len(points), faces.shape[0]), inputs=corners)
            given = [corners[0], wp.from_torch(normals, wp.vec3), *corners[1:]]
            drawn = [wp.from_torch(depth), wp.from_torch(bent, wp.vec3)]
            wp.launch(resolve, shape, inputs=[*given, *drawn])
        return depth, bent

    def _normals(self, points: Tensor, index: int) -> Tensor:
        """(n, V, 3) mean of the triangles at each vertex, by their areas."""
        corners = self._corners[index]
        a, b, c = (points[:, corners[:, k]] for k in range(3))
        # Not normalised: large triangles count more, so that slivers do not bend the shading.
        across = torch.linalg.cross(b - a, c - a)
        normals = torch.zeros_like(points)
        for k in range(3):
            normals.index_add_(1, corners[:, k], across)
        return torch.nn.functional.normalize(normals, dim=-1)

    def _over(self, image: Image, index: int, depth: Tensor, normals: Tensor, light: Tensor) -> Image:
        assert image.depth is not None  # the core asks for it
        depth = depth[..., None]
        nearer, color = depth < image.depth, self._colors[index]
        rgb = (255.0 * color * light).clamp(0.0, 255.0)
        opacity = self._scene.deformables[index].color[3]
        if opacity < 1.0 and image.rgb is not None:
            rgb = torch.lerp(image.rgb.to(rgb.dtype), rgb, opacity)
        return Image(
            rgb=_chosen(nearer, rgb.add(0.5), image.rgb),
            depth=_chosen(nearer, depth, image.depth),
            normals=_chosen(nearer, normals, image.normals),
            links=_chosen(nearer, torch.full_like(depth, float(self._first + index)), image.links),
            albedo=_chosen(nearer, (255.0 * color + 0.5).expand_as(normals), image.albedo),
        )


def _chosen(where: Tensor, new: Tensor, old: Tensor | None) -> Tensor | None:
    return None if old is None else torch.where(where, new.to(old.dtype), old)


def _light(lights: LightTable, normals: Tensor, reached: Tensor) -> Tensor:
    """Return the light (n, H, W, 3) on surfaces of those normals (n, H, W, 3), of ``reached`` (n, H, W, K) of each."""
    cosines = torch.relu(-(normals @ lights.directions.mT[:, None])) * reached
    return cosines @ lights.radiance[:, None] + lights.ambient[:, None, None]
