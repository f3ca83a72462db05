"""Pictures of a scene from poses alone, with MuJoCo's OpenGL renderer."""

# pyright: reportAttributeAccessIssue=false

from __future__ import annotations

import atexit
import math
import weakref
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import mujoco
import numpy as np
import numpy.typing as npt

from orbit_core.interfaces import (
    BACKGROUND,
    TERRAIN,
    ConfigurationError,
    SceneLayout,
    albedo_table,
)
from orbit_core.plugin_kit.rendering import HostLights, HostRenderer, HostRequest, Pictures, painted, repainted
from orbit_core.plugin_kit.simplify import simplified
from orbit_core.scene import CameraSpec
from orbit_mjmodel.visuals import all_variants
from orbit_mujoco.config import MujocoConfig
from orbit_mujoco.renderer_context import create_context
from orbit_mujoco.renderer_model import build_model, quaternion_matrix
from orbit_mujoco.renderer_rays import HIDDEN_GROUP, sky_colors, trace

_COLOR_FLAGS = (mujoco.mjtRndFlag.mjRND_SKYBOX, mujoco.mjtRndFlag.mjRND_CULL_FACE)
_ID_FLAGS = (mujoco.mjtRndFlag.mjRND_SEGMENT, mujoco.mjtRndFlag.mjRND_IDCOLOR, mujoco.mjtRndFlag.mjRND_CULL_FACE)
# Metres from a light to the middle of its shadows, which reach half as far around it, and at least so far.
_LIGHT_DISTANCE = 40.0
_LEAST_SHADOWS = 0.5
# Width of the map over the reach of what casts shadows: it is looked up one texel off at its rim, which would speckle
# surfaces there; half as far out the error is too small to.
_RIM = 2.0
# Pixels of the shadow map's sides, of small pictures and of those that are higher than so many pixels.
_PLAIN_SHADOWS, _FINE_SHADOWS, _LARGE = 1024, 2048, 400
# Times the farthest camera's range is drawn: the cube of the sky then hides nothing in range.
_SKY = 2.0
# Metres that are drawn at least: a light's view of the scene ends where the camera's does, and beyond is no shadow.
_LIGHT_REACH = 12.0

_Array = npt.NDArray[Any]
_open_renderers: weakref.WeakSet[MujocoRenderer] = weakref.WeakSet()


class MujocoRenderer(HostRenderer):
    """Draws a scene with lights, shadows and a sky.

    Depth, links, albedo and normals take transparent shapes for solid ones, and belong to the surface at each pixel's
    centre.
    Asked for normals, the renderer casts a ray through each pixel and gives the exact normals of the faces, with
    depth and links from the same rays. Markers are seen in colour alone.

    An OpenGL context belongs to one thread: use a renderer in the thread that made it.
    """

    def __init__(self, layout: SceneLayout, cameras: Sequence[CameraSpec], config: MujocoConfig) -> None:
        """Build the model to draw from, with buffers for the largest of the cameras.

        Raises:
            ConfigurationError: no OpenGL works here; says what to install.
        """
        if config.simplify_meshes:
            layout = simplified(layout, max((camera.height for camera in cameras), default=1))
        layout, shown = all_variants(layout)
        self._sky, self._links = layout.scene.sky, len(layout.links)
        self._size = (max((c.width for c in cameras), default=1), max((c.height for c in cameras), default=1))
        self._far = max((camera.far for camera in cameras), default=1.0)
        self._reach = max(_SKY * self._far, _LIGHT_REACH)
        shadow_size = config.shadow_size
        if shadow_size is None:
            shadow_size = _FINE_SHADOWS if self._size[1] > _LARGE else _PLAIN_SHADOWS
        self._shadows = shadow_size > 0
        self._model = build_model(layout, self._size, self._reach, max(shadow_size, 1), config.antialiasing)
        self._data = mujoco.MjData(self._model)
        mujoco.mj_forward(self._model, self._data)
        self._shown = np.zeros((len(shown), self._model.ngeom), dtype=bool)
        self._shown[:, : shown.shape[1]] = shown
        self._is_marker = np.arange(self._model.ngeom) >= shown.shape[1]
        # A plane shadows nothing that is drawn. In the map its own shadow would speckle it, for MuJoCo looks the map
        # up one texel off at its rim.
        self._casts_nothing = self._is_marker | (self._model.geom_type == mujoco.mjtGeom.mjGEOM_PLANE)
        # The reach of a height field is that of the whole terrain.
        fields = self._model.geom_type == mujoco.mjtGeom.mjGEOM_HFIELD
        self._casters = np.flatnonzero(~(self._casts_nothing | fields))
        self._lights_away = min(self._reach / 2.0, _LIGHT_DISTANCE)
        self._own_colors = self._model.geom_rgba.copy()
        bodies = self._model.geom_bodyid
        links = np.where(bodies > 0, bodies - 1, TERRAIN)
        # At the geom's index plus one; zero is the background.
        self._link_of_geom = np.concatenate(((BACKGROUND,), links)).astype(np.int32)
        self._links_of_geoms = np.where(self._is_marker, TERRAIN, links)
        self._albedo_of_geom = albedo_table(layout)
        # A colour pass serves for depth where it draws the same surfaces as an id pass, once a pixel.
        opaque = self._model.geom_rgba[: shown.shape[1], 3] == 1.0
        self._color_has_depth = config.antialiasing == 0 and bool(np.all(opaque))
        self._context = create_context(*self._size)
        self._context.make_current()
        self._buffers = mujoco.MjrContext(self._model, mujoco.mjtFontScale.mjFONTSCALE_100)
        mujoco.mjr_setBuffer(mujoco.mjtFramebuffer.mjFB_OFFSCREEN, self._buffers)
        self._buffers.readDepthMap = mujoco.mjtDepthMap.mjDEPTH_ZEROFAR
        self._scene = mujoco.MjvScene(self._model, maxgeom=max(self._model.ngeom, 1))
        self._option = mujoco.MjvOption()
        self._view = mujoco.MjvCamera()
        self._geoms_of_codes = [self._codes(kind) for kind in range(len(self._shown))]
        _open_renderers.add(self)
        # Registered after EGL's own farewell, this runs before it.
        atexit.unregister(_close_all)
        atexit.register(_close_all)

    def draw_pictures(self, request: HostRequest) -> Pictures:
        self._check(request.camera)
        wanted, pictures = request.wanted, Pictures()
        colors_measure = "rgb" in wanted and self._color_has_depth and request.markers is None
        if "normals" in wanted:
            pictures = self._trace(request)
        elif "links" in wanted or "albedo" in wanted or ("depth" in wanted and not colors_measure):
            pictures = self._draw_ids(request)
        if "rgb" in wanted:
            rgb, depth = self._draw_colors(request)
            pictures = replace(pictures, rgb=rgb, depth=depth if pictures.depth is None else pictures.depth)
        return pictures

    def free(self) -> None:
        _open_renderers.discard(self)
        self._context.make_current()
        self._buffers.free()
        self._context.free()

    # Kinds of pictures, (n, H, W, channels) --------------------------------------------------------------------------

    def _trace(self, request: HostRequest) -> Pictures:
        depth, normals, geoms = request.canvas("depth"), request.canvas("normals"), request.canvas("links")
        for i, pose in enumerate(request.cameras):
            self._place(request, i)
            trace(self._model, self._data, request.camera, pose, depth[i], normals[i], geoms[i])
        return self._measured(request, depth, geoms[..., 0] + 1, normals)

    def _draw_ids(self, request: HostRequest) -> Pictures:
        colors, heights = request.canvas("rgb"), request.canvas("depth")
        for i in range(len(request.cameras)):
            self._place(request, i)
            self._aim(request, i)
            self._draw(request.camera, _ID_FLAGS, colors[i], heights[i])
        # An id is spread over the three colours; OpenGL's rows count from below.
        codes = colors[:, ::-1].astype(np.int32) @ np.array([1, 1 << 8, 1 << 16], np.int32)
        geoms = [self._geoms_of_codes[self._kind(request, i)][code] for i, code in enumerate(codes)]
        depth = _metric_depth(heights, request.camera, self._reach)
        seen = np.isfinite(depth[..., 0])
        return self._measured(request, depth, np.where(seen, np.array(geoms).reshape(codes.shape), 0))

    def _measured(self, request: HostRequest, depth: _Array, geoms: _Array, normals: _Array | None = None) -> Pictures:
        """Return pictures with links and albedo of geoms (n, H, W), counted from one."""
        links = self._link_of_geom[geoms]
        albedo = repainted(self._albedo_of_geom[geoms], links, request.colors)
        return Pictures(depth=depth, normals=normals, links=links[..., None], albedo=albedo)

    def _draw_colors(self, request: HostRequest) -> tuple[_Array, _Array]:
        flags = _COLOR_FLAGS + ((mujoco.mjtRndFlag.mjRND_SHADOW,) if self._shadows else ())
        colors, heights = request.canvas("rgb"), request.canvas("depth")
        for i in range(len(request.cameras)):
            self._place(request, i, with_markers=True)
            self._aim(request, i)
            self._draw(request.camera, flags, colors[i], heights[i])
        depth = _metric_depth(heights, request.camera, self._reach)
        colors = np.ascontiguousarray(colors[:, ::-1])
        for picture, beyond, pose in zip(colors, np.isinf(depth[..., 0]), request.cameras, strict=True):
            picture[beyond] = sky_colors(self._sky, request.camera, pose, beyond)
        return colors, depth

    # One environment -------------------------------------------------------------------------------------------------

    def _kind(self, request: HostRequest, row: int) -> int:
        return int(request.environments[row]) % len(self._shown)

    def _place(self, request: HostRequest, row: int, with_markers: bool = False) -> None:
        shown = self._shown[self._kind(request, row)]
        poses = request.links[row]
        if with_markers and request.markers is not None:
            shown = shown | self._is_marker
            poses = np.concatenate((poses, request.markers[row]))
        self._show(shown)
        if request.colors is not None:
            self._model.geom_rgba = painted(self._own_colors, self._links_of_geoms, request.colors[row])
        self._data.mocap_pos[: len(poses)] = poses[:, :3]
        self._data.mocap_quat[: len(poses)] = poses[:, 3:]
        mujoco.mj_kinematics(self._model, self._data)

    def _show(self, geoms: npt.NDArray[np.bool_]) -> None:
        self._model.geom_group = np.where(geoms, 0, HIDDEN_GROUP)

    def _aim(self, request: HostRequest, row: int) -> None:
        self._update_scene()
        for geom in self._scene.geoms[: self._scene.ngeom]:
            if self._casts_nothing[geom.objid]:
                geom.category = mujoco.mjtCatBit.mjCAT_DECOR
        camera, pose = request.camera, request.cameras[row]
        rotation = quaternion_matrix(pose[3:])
        top = camera.near * math.tan(0.5 * camera.vertical_fov)
        for eye in self._scene.camera:
            eye.pos, eye.forward, eye.up = pose[:3], -rotation[:, 2], rotation[:, 1]
            eye.frustum_near, eye.frustum_far, eye.frustum_center = camera.near, self._reach, 0.0
            eye.frustum_top, eye.frustum_bottom = top, -top
            eye.frustum_width = top * camera.width / camera.height
        if request.lights is not None:
            self._set_lights(request.lights, row)
        # Shadows reach around a light's axis: point it at the middle of what moves.
        middle = self._data.mocap_pos[: self._links].mean(0) if self._links else np.zeros(3)
        self._buffers.shadowClip = self._shadow_radius(middle)
        for light in self._scene.lights[: self._scene.nlight]:
            if light.castshadow:
                light.pos = middle - self._lights_away * np.asarray(light.dir)

    def _shadow_radius(self, middle: _Array) -> float:
        """Return metres around ``middle`` that hold all that casts shadows, so that the map is as fine as it can be."""
        away = np.linalg.norm(self._data.geom_xpos[self._casters] - middle, axis=-1)
        shown = self._model.geom_group[self._casters] != HIDDEN_GROUP
        reach = float((away + self._model.geom_rbound[self._casters])[shown].max(initial=_LEAST_SHADOWS))
        return min(_RIM * reach, self._lights_away / 2.0)

    def _set_lights(self, lights: HostLights, row: int) -> None:
        number = 0
        for light in self._scene.lights[: self._scene.nlight]:
            if light.headlight:
                light.ambient = lights.ambient[row]
            else:
                light.dir = lights.directions[row, number]
                light.diffuse = light.specular = lights.radiance[row, number]
                number += 1

    def _update_scene(self) -> None:
        everything = mujoco.mjtCatBit.mjCAT_ALL
        mujoco.mjv_updateScene(self._model, self._data, self._option, None, self._view, everything, self._scene)

    def _draw(self, camera: CameraSpec, flags: tuple[mujoco.mjtRndFlag, ...], colors: _Array, heights: _Array) -> None:
        self._scene.flags[:] = 0
        self._scene.flags[[int(flag) for flag in flags]] = 1
        self._context.make_current()
        rectangle = mujoco.MjrRect(0, 0, camera.width, camera.height)
        mujoco.mjr_render(rectangle, self._scene, self._buffers)
        mujoco.mjr_readPixels(colors, heights, rectangle, self._buffers)

    # The rest --------------------------------------------------------------------------------------------------------

    def _codes(self, kind: int) -> npt.NDArray[np.int32]:
        """Return the geom's index plus one for each number in an id picture of a kind; zero is the background."""
        self._show(self._shown[kind])
        self._update_scene()
        geoms = np.zeros(self._scene.ngeom + 1, np.int32)
        for geom in self._scene.geoms[: self._scene.ngeom]:
            geoms[geom.segid + 1] = geom.objid + 1
        return geoms

    def _check(self, camera: CameraSpec) -> None:
        width, height = self._size
        if camera.width > width or camera.height > height or camera.far > self._far:
            raise ConfigurationError(
                f"camera '{camera.name}' is larger or sees farther than those that the renderer was made with "
                f"({width}x{height}, {self._far:g} m): make the renderer with it"
            )


def _metric_depth(heights: _Array, camera: CameraSpec, drawn: float) -> _Array:
    """Metres (n, H, W, 1) from OpenGL's reversed depth: 1 at the near plane, 0 at ``drawn`` and beyond it."""
    near, far = np.float32(camera.near), np.float32(drawn)
    heights = heights[:, ::-1]
    depth = near * far / (near + heights * (far - near))
    return np.where((heights > 0.0) & (depth <= camera.far), depth, np.float32(np.inf))


def _close_all() -> None:
    """Free what is open before the interpreter's modules are gone, when EGL would complain."""
    for renderer in list(_open_renderers):
        renderer.close()
