"""The ray through each pixel: what it meets, and in what light.

The ray casts are MuJoCo-Warp's, compiled for the kinds of shapes that the scene has.
"""

# pyright: reportIndexIssue=false, reportArgumentType=false, reportCallIssue=false, reportOperatorIssue=false
# pyright: reportAssignmentType=false, reportGeneralTypeIssues=false, reportAttributeAccessIssue=false
# pyright: reportReturnType=false
# Kernels are compiled by Warp; to Python they are annotations and calls that no type checker can follow.

from __future__ import annotations

import functools
from dataclasses import dataclass

import warp as wp
from mujoco_warp._src.math import rot_vec_quat
from mujoco_warp._src.render import _make_cast_ray, vertex_normal
from mujoco_warp._src.types import GeomType

from orbit_core.interfaces import BACKGROUND
from orbit_warp.renderer_stage import StageArrays

BLOCK_THREADS = 128
"""Threads of a block of rays."""
# Pixels that the threads of a warp draw: rays of a compact tile visit the same shapes, where those of a row of 32 part.
_TILE_WIDTH, _TILE_HEIGHT = wp.constant(8), wp.constant(4)
# Transparent shapes that a pixel shows, one behind the other.
_LAYERS = 4
# Metres, and share of the distance, that a ray starts above the surface that it leaves.
_LIFT = wp.constant(1e-4)
# Pixels of a texture that a ray may span before their mean takes over.
_BLURRED = wp.constant(24.0)
_FAR_AWAY = wp.constant(1e6)
_BACKGROUND = wp.constant(BACKGROUND)


@dataclass(frozen=True)
class TraceOptions:
    """Parts of the kernel. Registers of those left out are free, so that more rays are in flight."""

    geom_types: tuple[int, ...] = tuple(range(GeomType.MESH + 1))
    """Kinds of geoms that rays are tested against."""
    color: bool = True
    """True for colour pictures."""
    shadows: bool = True
    """True if lights cast shadows."""
    textured: bool = True
    """True if any shape has a texture."""
    transparent: bool = True
    """True if any shape or marker can be seen through."""
    markers: bool = True
    """True if markers may be drawn."""
    fast_math: bool = False
    """True for divisions and roots to 2 units in the last place. On a CPU it would lose the infinity of depth, too."""


@wp.struct
class Hit:
    """The hit of a ray on a geom; -1 where it met none."""

    geom: int
    """Number of the geom."""
    distance: float
    """m along the ray."""
    normal: wp.vec3
    """Normal of the face."""
    smooth: wp.vec3
    """Normal of the surface that the faces approximate."""
    place: wp.vec2
    """Coordinates on a mesh's texture."""


@wp.func
def surface_color(stage: StageArrays, env: int, geom: int) -> wp.vec3:
    rgba = stage.colors[env % stage.colors.shape[0], geom]
    return wp.vec3(rgba[0], rgba[1], rgba[2])


@wp.func
def sky(stage: StageArrays, direction: wp.vec3) -> wp.vec3:
    return wp.lerp(stage.sky_below, stage.sky_above, 0.5 + 0.5 * direction[2])


@wp.func
def byte(value: float) -> wp.uint8:
    return wp.uint8(wp.clamp(value, 0.0, 1.0) * 255.0 + 0.5)


@wp.func
def texel(stage: StageArrays, texture: int, column: int, row: int) -> wp.vec3:
    """Colour of a pixel of a texture, which repeats on all sides."""
    size = stage.texture_size[texture]
    x, y = ((column % size[0]) + size[0]) % size[0], ((row % size[1]) + size[1]) % size[1]
    at = stage.texture_address[texture] // 3 + y * size[0] + x
    return wp.vec3(float(stage.texels[at, 0]), float(stage.texels[at, 1]), float(stage.texels[at, 2])) / 255.0


@wp.func
def texture_color(stage: StageArrays, env: int, hit: Hit, point: wp.vec3, width: float) -> wp.vec3:
    """Colour of a surface's texture where a ray meets it, blended of four pixels; white without one.

    ``width`` is that of the ray there, along the surface: where it spans many of the texture's pixels, on wide ground,
    their mean takes over.
    """
    texture = stage.texture_of_geom[hit.geom]
    if texture < 0:
        return wp.vec3(1.0)
    size, repeat = stage.texture_size[texture], stage.texture_repeat[hit.geom]
    place = wp.vec2(hit.place[0], hit.place[1])
    share = wp.float32(1.0)
    if repeat[0] > 0.0:
        local = wp.transpose(stage.xmat[env, hit.geom]) @ (point - stage.xpos[env, hit.geom])
        place = wp.vec2(local[0] * repeat[0] + 0.5, 0.5 - local[1] * repeat[1])
        share = wp.clamp(_BLURRED / (width * repeat[0] * float(size[0])), 0.0, 1.0)
    x, y = place[0] * float(size[0]) - 0.5, place[1] * float(size[1]) - 0.5
    low_x, low_y = wp.floor(x), wp.floor(y)
    right, below = x - low_x, y - low_y
    column, row = int(low_x), int(low_y)
    upper = wp.lerp(texel(stage, texture, column, row), texel(stage, texture, column + 1, row), right)
    lower = wp.lerp(texel(stage, texture, column, row + 1), texel(stage, texture, column + 1, row + 1), right)
    return wp.lerp(stage.texture_mean[texture], wp.lerp(upper, lower, below), share)


def _cast(geom_types: tuple[int, ...], first_hit: bool) -> wp.Function:
    """Return MuJoCo-Warp's ray cast bound to the stage; ``colors`` decide which shapes are visible."""
    cast_ray = _make_cast_ray(geom_types, first_hit)

    @wp.func
    def cast(
        stage: StageArrays, colors: wp.array2d[wp.vec4], env: int, origin: wp.vec3, direction: wp.vec3, reach: float
    ) -> Hit:
        geom, distance, normal, u, v, face, mesh = cast_ray(
            stage.geom_type, stage.geom_dataid, stage.geom_matid, stage.geom_size, colors,
            stage.no_ints, stage.no_edges, stage.no_floats, colors, stage.xpos, stage.xmat, stage.no_points,
            stage.bvh, stage.roots[env], env, stage.geoms, 0, stage.every_geom, stage.mesh_ids, stage.hfield_ids,
            stage.no_colors, stage.no_ints, stage.no_ints, stage.no_ids, stage.no_table,
            origin, direction, reach, True,
        )  # fmt: skip
        hit = Hit()
        hit.geom = geom
        hit.distance = distance
        hit.normal = normal
        hit.smooth = normal
        if mesh >= 0:
            turn = stage.xmat[env, geom]
            corners = stage.mesh_facenormal[stage.mesh_faceadr[mesh] + face]
            first = stage.mesh_normaladr[mesh]
            flat = wp.transpose(turn) @ normal
            bent = (
                u * vertex_normal(stage.mesh_normal[first + corners[0]], flat)
                + v * vertex_normal(stage.mesh_normal[first + corners[1]], flat)
                + (1.0 - u - v) * vertex_normal(stage.mesh_normal[first + corners[2]], flat)
            )
            hit.smooth = wp.normalize(turn @ bent)
            if stage.mesh_texcoordadr[mesh] >= 0:
                ends = stage.mesh_facetexcoord[stage.mesh_faceadr[mesh] + face]
                start = stage.mesh_texcoordadr[mesh]
                hit.place = (
                    u * stage.mesh_texcoord[start + ends[0]]
                    + v * stage.mesh_texcoord[start + ends[1]]
                    + (1.0 - u - v) * stage.mesh_texcoord[start + ends[2]]
                )
        return hit

    return cast


@wp.func
def pixel_of_thread(thread: int, width: int, height: int) -> int:
    """Return the pixel (row * width + column) of a thread: tile after tile, or row after row where tiles do not fit."""
    if width % _TILE_WIDTH != 0 or height % _TILE_HEIGHT != 0:
        return thread
    tile, inside = thread // (_TILE_WIDTH * _TILE_HEIGHT), thread % (_TILE_WIDTH * _TILE_HEIGHT)
    across = width // _TILE_WIDTH
    row = (tile // across) * _TILE_HEIGHT + inside // _TILE_WIDTH
    return row * width + (tile % across) * _TILE_WIDTH + inside % _TILE_WIDTH


@functools.cache
def trace_kernel(options: TraceOptions) -> wp.Kernel:
    """Return the kernel with those parts."""
    nearest = _cast(options.geom_types, first_hit=False)
    blocking = _cast(options.geom_types, first_hit=True)
    shadows, textured, transparent = options.shadows, options.textured, options.transparent
    with_color, may_mark = options.color, options.markers

    @wp.func
    def light(stage: StageArrays, env: int, hit: Hit, point: wp.vec3) -> wp.vec3:
        """Light of each colour that reaches the point, from around and from the lights."""
        row = env % stage.ambient.shape[0]
        total = stage.ambient[row]
        for i in range(stage.light_dir.shape[1]):
            toward = -stage.light_dir[row, i]
            share = wp.dot(hit.smooth, toward)
            if share > 0.0:
                if wp.static(shadows) and stage.light_casts[i]:
                    start = point + (_LIFT + _LIFT * hit.distance) * hit.normal
                    if blocking(stage, stage.shadow_colors, env, start, toward, _FAR_AWAY).geom >= 0:
                        share = 0.0
                total += share * stage.light_color[row, i]
        return total

    @wp.func
    def surface(stage: StageArrays, env: int, hit: Hit, point: wp.vec3, direction: wp.vec3, width: float) -> wp.vec3:
        """Colour of a surface in its light, where a ray of that width meets it."""
        own = surface_color(stage, env, hit.geom)
        if wp.static(textured):
            slant = wp.max(-wp.dot(direction, hit.normal), 0.01)
            own = wp.cw_mul(own, texture_color(stage, env, hit, point, width / slant))
        return wp.cw_mul(own, light(stage, env, hit, point))

    @wp.func
    def color_along(
        stage: StageArrays, env: int, first: Hit, origin: wp.vec3, direction: wp.vec3, reach: float, pixel: float
    ) -> wp.vec3:
        """The colour that comes along a ray, through what is transparent."""
        color, through = wp.vec3(0.0), wp.float32(1.0)
        hit, start, left = first, origin, reach
        for _layer in range(_LAYERS):
            if hit.geom < 0:
                break
            point = start + hit.distance * direction
            opacity = stage.colors[env % stage.colors.shape[0], hit.geom][3]
            seen = surface(stage, env, hit, point, direction, pixel * (reach - left + hit.distance))
            color += through * opacity * seen
            through *= 1.0 - opacity
            if through < 0.01:
                break
            step = hit.distance + _LIFT
            start += step * direction
            left -= step
            hit = nearest(stage, stage.colors, env, start, direction, left)
        return color + through * sky(stage, direction)

    @wp.func
    def opaque_color(
        stage: StageArrays, env: int, hit: Hit, origin: wp.vec3, direction: wp.vec3, pixel: float
    ) -> wp.vec3:
        """The colour that comes along a ray where nothing is transparent."""
        if hit.geom < 0:
            return sky(stage, direction)
        return surface(stage, env, hit, origin + hit.distance * direction, direction, pixel * hit.distance)

    @wp.kernel(
        module="unique", enable_backward=False, grid_stride=False, module_options={"fast_math": options.fast_math}
    )
    def trace(
        stage: StageArrays,
        camera_poses: wp.array2d[float],
        width: int,
        height: int,
        pixel_size: float,
        near: float,
        far: float,
        with_markers: bool,
        chosen: wp.array[wp.bool],
        rgb: wp.array3d[wp.uint8],
        depth: wp.array3d[float],
        normals: wp.array3d[float],
        links: wp.array3d[int],
        albedo: wp.array3d[wp.uint8],
    ):
        env, thread = wp.tid()
        pixel = pixel_of_thread(thread, width, height)
        if chosen.shape[0] > 0 and not chosen[env]:
            return
        eye = wp.vec3(camera_poses[env, 0], camera_poses[env, 1], camera_poses[env, 2])
        q = wp.quat(camera_poses[env, 3], camera_poses[env, 4], camera_poses[env, 5], camera_poses[env, 6])
        x = (float(pixel % width) + 0.5 - 0.5 * float(width)) * pixel_size
        y = (0.5 * float(height) - 0.5 - float(pixel // width)) * pixel_size
        length = wp.sqrt(x * x + y * y + 1.0)
        direction = rot_vec_quat(wp.vec3(x, y, -1.0), q) / length
        origin = eye + near * length * direction
        reach = (far - near) * length
        hit = nearest(stage, stage.solid_colors, env, origin, direction, reach)
        seen = hit.geom >= 0
        if depth.shape[0] > 0:
            depth[env, pixel, 0] = wp.where(seen, near + hit.distance / length, wp.inf)
        if links.shape[0] > 0:
            links[env, pixel, 0] = _BACKGROUND
            if seen:
                links[env, pixel, 0] = stage.link_of_geom[hit.geom]
        for i in range(3):
            if normals.shape[0] > 0:
                normals[env, pixel, i] = wp.where(seen, hit.normal[i], 0.0)
            if albedo.shape[0] > 0:
                albedo[env, pixel, i] = wp.uint8(0)
                if seen:
                    albedo[env, pixel, i] = byte(stage.colors[env % stage.colors.shape[0], hit.geom][i])
        if wp.static(with_color):
            if wp.static(may_mark):  # noqa: SIM102 (Warp drops a branch only where the whole condition is static)
                if with_markers:
                    hit = nearest(stage, stage.colors, env, origin, direction, reach)
            color = wp.vec3(0.0)
            if wp.static(transparent):
                color = color_along(stage, env, hit, origin, direction, reach, pixel_size)
            else:
                color = opaque_color(stage, env, hit, origin, direction, pixel_size)
            for i in range(3):
                rgb[env, pixel, i] = byte(color[i])

    return trace
