"""Pictures of a scene from poses alone, with Bullet's software renderer or its OpenGL one."""

from __future__ import annotations

import contextlib
import math
from collections.abc import Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from orbit_bullet import opengl
from orbit_bullet.config import BulletConfig
from orbit_bullet.library import Client, refusals, silence
from orbit_bullet.lighting import add_light, facing_once, facing_pair, pixel_rays, sky_colors, textured_albedo
from orbit_bullet.normals import normals_of
from orbit_bullet.shadows import MapCamera, ball_radius, map_camera
from orbit_bullet.visuals import VisualShapes
from orbit_core.interfaces import (
    BACKGROUND,
    TERRAIN,
    ConfigurationError,
    SceneLayout,
    SimulationError,
    albedo_table,
    drawn_shapes,
)
from orbit_core.plugin_kit.meshes import marker_shapes
from orbit_core.plugin_kit.rendering import HostLights, HostRenderer, HostRequest, Pictures, painted, repainted
from orbit_core.plugin_kit.rotations import compose, rotate
from orbit_core.plugin_kit.scratch import ScratchFolder
from orbit_core.plugin_kit.simplify import simplified
from orbit_core.scene import CameraSpec, Channel, Shape
from orbit_core.scene.pose import Vector3

_Array = npt.NDArray[Any]
# Up to which the software renderer is the faster.
_TINY_PIXELS = 128 * 128
# Position of markers while they are not drawn.
_HIDDEN = (0.0, 0.0, -1e4)


class BulletRenderer(HostRenderer):
    """Draws lit shapes, one picture at a time.

    Normals are those of the depth image. Markers are seen in colour alone.
    """

    # Each is made of one or two pictures for a light, and one from its side.
    most_samples = 2

    def __init__(self, layout: SceneLayout, cameras: Sequence[CameraSpec], config: BulletConfig) -> None:
        """Build the shapes.

        Raises:
            ConfigurationError: OpenGL was asked for, and is missing or in use by another renderer of this process.
        """
        if config.simplify_meshes:
            layout = simplified(layout, max((camera.height for camera in cameras), default=1))
        self._config, self._scene = config, layout.scene
        wanted = config.renderer == "egl" or (config.renderer == "auto" and _suits_opengl(cameras))
        self._opengl = opengl.acquire() if wanted else None
        if config.renderer == "egl" and self._opengl is None:
            cause = "another renderer of this process has it" if opengl.loads() else "its plugin does not load here"
            raise ConfigurationError(f"renderer 'egl' needs OpenGL, but {cause}: choose renderer = 'tiny'")
        self._client = Client() if self._opengl is None else self._opengl.client
        try:
            with self._drawing():
                self._build(layout)
        except BaseException:
            self.free()
            raise

    def _build(self, layout: SceneLayout) -> None:
        refused = refusals("Bullet cannot draw the scene", SimulationError)
        with ScratchFolder("orbit-bullet-") as folder, silence(), refused:
            shapes = VisualShapes(self._client, folder)
            things = drawn_shapes(layout)
            self._links = np.array([link for _, link in things], dtype=np.int64)
            self._offsets = np.array([_flat(shape) for shape, _ in things]).reshape(-1, 7)
            self._bodies = [shapes.add(shape) for shape, _ in things]
            self._textured = any(shape.finish.texture is not None for shape, _ in things)
            self._own_colors = np.array([shape.color for shape, _ in things], np.float32).reshape(-1, 4)
            self._colors = self._own_colors
            radii = np.array([ball_radius(shape.geometry) for shape, _ in things], dtype=np.float64)
            self._casters = (self._offsets[:, :3].astype(np.float64), radii)
            marks = [(shape, n) for n, spec in enumerate(layout.scene.markers) for shape in marker_shapes(spec)]
            self._marker_of = np.array([number for _, number in marks], dtype=np.int64)
            self._marker_offsets = np.array([_flat(shape) for shape, _ in marks]).reshape(-1, 7)
            self._marker_bodies = [shapes.add(shape) for shape, _ in marks]
        self._place(self._marker_bodies, np.tile((*_HIDDEN, 1.0, 0, 0, 0), (len(marks), 1)))
        last = max((*self._bodies, *self._marker_bodies), default=0)
        # At a body's number plus one, as the next.
        self._link_of_body = np.full(last + 2, BACKGROUND, dtype=np.int32)
        self._albedo_of_body = np.zeros((last + 2, 3), dtype=np.uint8)
        self._albedo_of_body[np.array(self._bodies, dtype=np.int64) + 1] = albedo_table(layout)[1:]
        for body, (shape, _) in zip(self._marker_bodies, marks, strict=True):
            self._albedo_of_body[body + 1] = [round(255 * part) for part in shape.color[:3]]
        self._own_albedo_of_body = self._albedo_of_body.copy()
        self._link_of_body[np.array(self._bodies, dtype=np.int64) + 1] = self._links
        still = self._links == TERRAIN
        self._place([body for body, here in zip(self._bodies, still, strict=True) if here], self._offsets[still])
        self._moving = np.flatnonzero(~still)

    def _drawing(self) -> contextlib.AbstractContextManager[None]:
        """Return a context in which all calls of OpenGL happen."""
        return contextlib.nullcontext() if self._opengl is None else self._opengl.current()

    def draw_pictures(self, request: HostRequest) -> Pictures:
        with self._drawing():
            return self._draw_pictures(request)

    def _draw_pictures(self, request: HostRequest) -> Pictures:
        camera, wanted = request.camera, request.wanted
        marks = request.markers if self._marker_bodies else None
        rgb, depth = request.canvas("rgb"), request.canvas("depth")
        bodies = np.zeros(depth.shape[:-1], np.int64)
        lights = request.lights or HostLights.of_scene(self._scene, len(request.cameras))
        for i, pose in enumerate(request.cameras):
            links = request.links[i]
            self._place_links(links)
            if request.colors is not None:
                self._paint(request.colors[i])
            if "rgb" in wanted:
                middle = links[:, :3].mean(0) if len(links) else np.zeros(3)
                rgb[i], depth[i], bodies[i] = self._draw_colors(
                    camera, pose, middle, None if marks is None else marks[i], lights, i
                )
            if wanted.measured and (marks is not None or "rgb" not in wanted):
                _, depth[i], bodies[i] = self._draw(camera, pose)
        links = self._link_of_body[bodies][..., None]
        normals = normals_of(depth, links, camera, request.cameras) if "normals" in wanted else None
        albedo = (
            repainted(self._own_albedo_of_body[bodies], links[..., 0], request.colors) if "albedo" in wanted else None
        )
        return Pictures(rgb, depth, normals, links, albedo)

    def free(self) -> None:
        if self._opengl is None:
            self._client.close()
        else:
            opengl.release(self._opengl)

    # One picture -----------------------------------------------------------------------------------------------------

    def _draw_colors(
        self, camera: CameraSpec, pose: _Array, middle: _Array, marks: _Array | None, lights: HostLights, row: int
    ) -> tuple[_Array, _Array, _Array]:
        """A picture with markers, in the lights of a row; and depth and bodies in it."""
        lamps, directions = self._scene.directional_lights, lights.directions[row].tolist()
        if marks is not None:
            self._place_markers(marks)
        layers = [self._draw(camera, pose, way) for way in directions[: len(lamps)]] or [self._draw(camera, pose)]
        _, depth, bodies = layers[0]
        albedo = self._albedo_of_body[bodies].astype(np.float32)
        facing = [layer[0] for layer in layers]
        if self._opengl is not None:
            opposite = self._draw(camera, pose, tuple(-part for part in directions[0]))[0] if lamps else facing[0]
            if self._textured:
                albedo = np.minimum(textured_albedo(facing[0], opposite), albedo)
            # The picture from behind has no highlight; further lamps do with one picture each.
            facing = [facing_pair(facing[0], opposite, albedo), *(facing_once(each, albedo) for each in facing[1:])]
        elif self._textured:
            # Without textures a body's own colour is known, which saves a picture.
            albedo = self._draw(camera, pose, ambient=True)[0].astype(np.float32)
        if marks is not None:
            self._place_markers(None)
        rays, rotation = pixel_rays(camera), _rotation(pose)
        colors = albedo * lights.ambient[row].astype(np.float32)
        points = pose[:3] + (np.where(np.isfinite(depth), depth, 0.0) * rays) @ rotation.T
        for lamp, way, radiance, seen in zip(lamps, directions, lights.radiance[row], facing, strict=False):
            casts = lamp.shadows and self._config.shadows
            eye = map_camera(way, points[bodies > 0], self._casters, middle, camera)
            reached = (
                self._reached(eye, way, seen, albedo, points, bodies, self._coarse(camera, depth)) if casts else None
            )
            add_light(colors, seen, radiance, reached)
        nothing = bodies == 0
        colors = colors.astype(np.float32)
        colors[nothing] = sky_colors(self._scene.sky, rays[nothing], rotation)
        return np.minimum(colors + 0.5, 255.0).astype(np.uint8), depth, bodies

    def _reached(
        self,
        eye: MapCamera,
        direction: Vector3,
        facing: _Array,
        albedo: _Array,
        points: _Array,
        bodies: _Array,
        coarse: _Array,
    ) -> _Array:
        """(H, W) whether a light reaches the points (H, W, 3) that are seen, of which ``facing`` is lit by it alone."""
        _, buffer, codes = self._take(eye.size, eye.size, eye.view, eye.vertical_fov, eye.near, eye.far, direction)
        depths = np.where(codes < 0, np.inf, _metres(buffer, eye.near, eye.far))
        reached, seen = np.ones(bodies.shape, dtype=bool), bodies > 0
        cosines = (facing[seen].max(-1) + 0.5) / np.maximum(albedo[seen].max(-1), 1.0)
        reached[seen] = eye.reached(points[seen], cosines, depths, coarse[seen])
        return reached

    def _coarse(self, camera: CameraSpec, depth: _Array) -> _Array:
        """(H, W) metres between neighbouring values of the depth buffer, of which OpenGL's has 16 bits."""
        if self._opengl is None:
            return np.zeros(depth.shape[:-1])
        seen = np.where(np.isfinite(depth[..., 0]), depth[..., 0], 0.0)
        return seen**2 / (camera.near * 2.0**16)

    def _draw(
        self, camera: CameraSpec, pose: _Array, direction: Vector3 = (0.0, 0.0, -1.0), ambient: bool = False
    ) -> tuple[_Array, _Array, _Array]:
        """Colours in white light along ``direction``, or from all around if ``ambient``; depth and bodies."""
        near, far, fov = camera.near, camera.far, camera.vertical_fov
        eye = (_view_matrix(pose), fov, near, far, direction, ambient)
        rgb, buffer, bodies = self._take(camera.width, camera.height, *eye)
        depth = _metres(buffer, near, far)
        nothing = (bodies < 0) | (depth >= far * (1 - 1e-6))
        return rgb, np.where(nothing, np.inf, depth)[..., None], np.where(nothing, 0, (bodies & 0xFFFFFF) + 1)

    def _take(
        self,
        width: int,
        height: int,
        view: list[float],
        fov: float,
        near: float,
        far: float,
        direction: Vector3,
        ambient: bool = False,
    ) -> tuple[_Array, _Array, _Array]:
        """Colours (H, W, 3), depth buffer (H, W) and body codes (H, W) as Bullet has them."""
        client = self._client
        projection = list(client.computeProjectionMatrixFOV(math.degrees(fov), width / height, near, far))
        if (
            self._opengl is None
        ):  # the software renderer looks through a pixel's corner: shift the picture by half of one
            projection[8] += 1.0 / width
            projection[9] += 1.0 / height
        picture = client.getCameraImage(
            width,
            height,
            viewMatrix=view,
            projectionMatrix=projection,
            lightDirection=[-part for part in direction],
            lightColor=(1.0, 1.0, 1.0),
            lightAmbientCoeff=float(ambient),
            lightDiffuseCoeff=float(not ambient),
            lightSpecularCoeff=0.0,
            # OpenGL's own shadows fall beside what casts them; both renderers have the map's.
            shadow=0,
            renderer=client.ER_TINY_RENDERER if self._opengl is None else client.ER_BULLET_HARDWARE_OPENGL,
        )
        rgb = np.asarray(picture[2], dtype=np.uint8).reshape(height, width, 4)[..., :3]
        buffer = np.asarray(picture[3], dtype=np.float64).reshape(height, width)
        return rgb, buffer, np.asarray(picture[4], dtype=np.int64).reshape(height, width)

    def _place_links(self, links: _Array) -> None:
        if len(self._moving):
            frames = links[self._links[self._moving]]
            position, orientation = compose(frames[:, :3], frames[:, 3:], self._offsets[self._moving])
            self._casters[0][self._moving] = position
            bodies = [self._bodies[number] for number in self._moving]
            self._place(bodies, np.concatenate((position, orientation), -1))

    def _paint(self, colors: _Array) -> None:
        """Give shapes their links' colours (L, 4), where these have one."""
        painting = painted(self._own_colors, self._links, colors)
        for body, color, before in zip(self._bodies, painting.tolist(), self._colors.tolist(), strict=True):
            if color != before:
                self._client.changeVisualShape(body, -1, rgbaColor=color)
                self._albedo_of_body[body + 1] = [round(255 * part) for part in color[:3]]
        self._colors = painting

    def _place_markers(self, poses: _Array | None) -> None:
        if poses is None:
            places = np.tile((*_HIDDEN, 1.0, 0, 0, 0), (len(self._marker_bodies), 1))
        else:
            frames = poses[self._marker_of]
            places = np.concatenate(compose(frames[:, :3], frames[:, 3:], self._marker_offsets), -1)
        self._place(self._marker_bodies, places)

    def _place(self, bodies: list[int], poses: _Array) -> None:
        for body, (x, y, z, a, b, c, d) in zip(bodies, poses.tolist(), strict=True):
            self._client.resetBasePositionAndOrientation(body, (x, y, z), (b, c, d, a))


def _suits_opengl(cameras: Sequence[CameraSpec]) -> bool:
    """Return True if pictures are large, and none needs a depth finer than the 16 bits of Bullet's OpenGL."""
    largest = max((camera.width * camera.height for camera in cameras), default=0)
    measured = any({Channel.DEPTH, Channel.POSITION, Channel.NORMALS} & set(camera.channels) for camera in cameras)
    return largest > _TINY_PIXELS and not measured


def _metres(buffer: _Array, near: float, far: float) -> _Array:
    return far * near / np.maximum(far - (far - near) * buffer, 1e-12)


def _rotation(pose: _Array) -> _Array:
    """(3, 3) whose columns are the camera's axes."""
    return rotate(np.tile(pose[3:], (3, 1)), np.eye(3)).T


def _view_matrix(pose: _Array) -> list[float]:
    """World to camera, column by column."""
    rotation = _rotation(pose)
    view = np.eye(4)
    view[:3, :3] = rotation.T
    view[:3, 3] = -rotation.T @ pose[:3]
    return view.T.ravel().tolist()


def _flat(shape: Shape) -> tuple[float, ...]:
    return (*shape.pose.position, *shape.pose.orientation)
