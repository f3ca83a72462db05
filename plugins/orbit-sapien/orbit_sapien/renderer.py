"""Pictures of a scene from poses only, of any engine: rasterised, or by path tracing."""

# pyright: reportAttributeAccessIssue=false
# SAPIEN's stubs ask for shapes of arrays that NumPy's types cannot express.
# pyright: reportArgumentType=false
# pyright: reportAttributeAccessIssue=false, reportArgumentType=false

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from orbit_core.interfaces import BACKGROUND, TERRAIN, ConfigurationError, SceneLayout
from orbit_core.plugin_kit.rendering import HostLights, HostRenderer, HostRequest, Pictures
from orbit_core.scene import CameraSpec, Color, Scene
from orbit_sapien.config import SapienConfig
from orbit_sapien.denoising import Denoiser, host_denoiser
from orbit_sapien.native import NativePose, sapien
from orbit_sapien.renderer_shapes import base_color, marker_shapes, render_shape
from orbit_sapien.shader_packs import shader_pack

# Metres from a light that casts shadows to the middle of its shadows.
_DISTANCE = 10.0
# Metres around the middle that shadows reach.
_REACH = 3.0
_GAMMA = 2.2
# SAPIEN's ACES curve, which keeps shape and colour in what is brightly lit, and light to match the rasterised pictures.
_FILMIC, _EXPOSURE = 2, 1.15


class Lights:
    """All lights of a scene.

    Tier ``fast`` takes the scene's numbers as they are, for its shader works in the picture's. The others compute in
    linear light, where light adds up otherwise: theirs is such that what is in no directional light, and what faces
    a single one, is as bright as with ``fast``.
    """

    def __init__(self, native: sapien.Scene, scene: Scene, config: SapienConfig) -> None:
        self._native, self._linear = native, config.tier != "fast"
        self._lamps: list[Any] = []
        self._casts: list[bool] = []
        for lamp in scene.directional_lights:
            casts = lamp.shadows and (config.shadow_size > 0 or config.tier == "rt")
            made = native.add_directional_light(
                lamp.unit_direction, [1.0, 1.0, 1.0], shadow=casts, shadow_scale=_REACH, shadow_near=0.1,
                shadow_far=2.5 * _DISTANCE, shadow_map_size=max(config.shadow_size, 1),
            )  # fmt: skip
            self._lamps.append(made)
            self._casts.append(casts)
        self._own = HostLights.of_scene(scene, 1)

    def place(self, lights: HostLights | None, row: int, middle: npt.NDArray[Any]) -> None:
        """Shine as the lights of a row do, or else as the scene's, with shadows around a place (3,)."""
        table, row = (self._own, 0) if lights is None else (lights, row)
        ambient = table.ambient[row]
        self._native.set_ambient_light((ambient**_GAMMA if self._linear else ambient).tolist())
        for lamp, casts, direction, radiance in zip(
            self._lamps, self._casts, table.directions[row], table.radiance[row], strict=False
        ):
            lamp.set_color((_linear(radiance, ambient) if self._linear else radiance).tolist())
            place = middle - _DISTANCE * direction if casts else np.zeros(3)
            lamp.entity.set_pose(NativePose(place.astype(np.float32), _x_along(direction)))


def _linear(radiance: npt.NDArray[np.float64], ambient: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
    return math.pi * ((radiance + ambient) ** _GAMMA - ambient**_GAMMA)


def _x_along(direction: npt.NDArray[np.float64]) -> npt.NDArray[np.float32]:
    """Return the shortest turn (w, x, y, z) of the axis x, along which SAPIEN's lights shine, to a direction."""
    x, y, z = direction
    if x < -1.0 + 1e-9:  # opposite: any axis across will do
        return np.array((0.0, 0.0, 0.0, 1.0), np.float32)
    turn = np.array((1.0 + x, 0.0, -z, y))
    return (turn / np.linalg.norm(turn)).astype(np.float32)


_Array = npt.NDArray[Any]
# Pose of markers while they are not drawn.
_AWAY = NativePose([0.0, 0.0, -1e4])


class SapienRenderer(HostRenderer):
    """Draws one copy of the scene, posed as each environment is in turn.

    Depth, normals, albedo and links come from a rasteriser at each pixel's centre in every tier; the tier is colour's.
    They take transparent shapes for solid ones. Markers are seen in colour alone.
    """

    def __init__(self, layout: SceneLayout, cameras: Sequence[CameraSpec], config: SapienConfig) -> None:
        """Build what is drawn.

        Raises:
            ConfigurationError: no Vulkan driver fits, or a denoiser has no NVIDIA GPU; it says what to install.
        """
        self._layout, self._config = layout, config
        if config.tier == "rt":
            # It averages over pixels by itself, and a picture takes seconds.
            self.most_samples = 1
        self._system = _render_system()
        # SAPIEN's denoisers need an NVIDIA GPU; without one it says so in its log, and leaves the picture as it is.
        self._denoise: Denoiser | None = None
        if config.tier == "rt" and config.denoiser != "none" and not self._system.device.is_cuda():
            self._denoise = host_denoiser(config.denoiser)
        self._scene = sapien.Scene([self._system])
        reach = 2.0 * max((camera.far for camera in cameras), default=100.0)
        self._link_of_id: dict[int, int] = {}
        # Each link's shapes, with their own colours.
        self._painted: list[tuple[int, sapien.render.RenderShape, Color]] = []
        self._links = self._add_links(reach)
        self._markers = [self._add(marker_shapes(marker), None) for marker in layout.scene.markers]
        self._lights = Lights(self._scene, layout.scene, config)
        self._cameras: dict[tuple[CameraSpec, str], tuple[sapien.Entity, Any]] = {}
        self._lookup = np.full(max(self._link_of_id, default=0) + 2, BACKGROUND, np.int32)
        for number, link in self._link_of_id.items():
            self._lookup[number] = link

    # What is drawn ---------------------------------------------------------------------------------------------------

    def _add_links(self, reach: float) -> list[tuple[int, sapien.Entity]]:
        for shape in self._layout.scene.terrain:
            self._add([render_shape(shape, reach)], TERRAIN)
        placed: list[tuple[int, sapien.Entity]] = []
        for number, link in enumerate(self._layout.links):
            drawn = link.visuals or link.collisions
            shapes = [render_shape(shape, reach) for shape in drawn]
            self._painted += [(number, shape, own.color) for shape, own in zip(shapes, drawn, strict=True)]
            if shapes:
                placed.append((number, self._add(shapes, number)))
        return placed

    def _add(self, shapes: list[sapien.render.RenderShape], link: int | None) -> sapien.Entity:
        body = sapien.render.RenderBodyComponent()
        for shape in shapes:
            body.attach(shape)
        entity = sapien.Entity()
        entity.add_component(body)
        if link is None:
            entity.set_pose(_AWAY)
        self._scene.add_entity(entity)
        if link is not None:
            self._link_of_id[entity.per_scene_id] = link
        return entity

    # Pictures --------------------------------------------------------------------------------------------------------

    def draw_pictures(self, request: HostRequest) -> Pictures:
        camera, wanted = request.camera, request.wanted
        colored = "rgb" in wanted
        rgb, depth, links = request.canvas("rgb"), request.canvas("depth"), request.canvas("links")
        normals, albedo = request.canvas("normals"), request.canvas("albedo")
        for row, pose in enumerate(request.cameras):
            taken = None
            self._place(request.links[row])
            middle = request.links[row, :, :3].mean(0) if request.links.shape[1] else np.zeros(3)
            self._lights.place(request.lights, row, middle)
            if request.colors is not None:
                self._paint(request.colors[row])
            if colored:
                self._place_markers(None if request.markers is None else request.markers[row])
                taken = self._take(camera, self._config.tier, pose)
                rgb[row] = _bytes(self._denoised(taken))
            if wanted.measured:
                if taken is None or self._config.tier != "fast" or request.markers is not None:
                    self._place_markers(None)
                    taken = self._take(camera, "fast", pose)
                numbers = taken.get_picture("Segmentation")[..., 1:2]
                seen = numbers > 0
                links[row] = self._lookup[numbers]
                depth[row] = np.where(seen, -taken.get_picture("Position")[..., 2:3], np.inf)
                if "normals" in wanted:
                    normal = taken.get_picture("Normal")[..., :3]
                    length = np.linalg.norm(normal, axis=-1, keepdims=True)
                    normals[row] = np.where(seen, normal / np.maximum(length, 1e-12), 0.0)
                if "albedo" in wanted:
                    albedo[row] = np.where(seen, _bytes(taken.get_picture("Albedo")[..., :3]), 0)
        return Pictures(rgb, depth, normals, links, albedo)

    def _denoised(self, taken: Any) -> _Array:
        """Return the colours (H, W, 3) of a picture, denoised as the settings say."""
        color = taken.get_picture("Color")[..., :3]
        if self._denoise is not None:
            return self._denoise(color, taken.get_picture("Albedo")[..., :3], taken.get_picture("Normal")[..., :3])
        # A denoiser of SAPIEN's that fails leaves black, and says so in its log only.
        if self._config.tier == "rt" and self._config.denoiser != "none" and not color.any():
            raise ConfigurationError(
                f"denoiser '{self._config.denoiser}' does not work with this graphics driver: choose another or 'none'"
            )
        return color

    def _take(self, camera: CameraSpec, tier: str, pose: _Array) -> Any:
        """A picture of the present scene, from a camera of that tier."""
        entity, eye = self._camera(camera, tier)
        entity.set_pose(NativePose(pose[:3], _looking_along_x(pose[3:])))
        self._scene.update_render()
        eye.take_picture()
        return eye

    def _camera(self, camera: CameraSpec, tier: str) -> tuple[sapien.Entity, Any]:
        key = camera, tier
        if key not in self._cameras:
            if tier == "rt":
                sapien.render.set_ray_tracing_samples_per_pixel(self._config.samples_per_pixel)
                sapien.render.set_ray_tracing_path_depth(self._config.path_depth)
                sapien.render.set_ray_tracing_denoiser("none" if self._denoise else self._config.denoiser)
            eye = sapien.render.RenderCameraComponent(
                camera.width, camera.height, shader_pack(tier, self._layout.scene.sky)
            )
            focal = 0.5 * camera.height / math.tan(0.5 * camera.vertical_fov)
            eye.set_perspective_parameters(
                camera.near, camera.far, focal, focal, 0.5 * camera.width, 0.5 * camera.height, 0.0
            )
            if tier == "rt":
                eye.set_property("toneMapper", _FILMIC)
                eye.set_property("exposure", _EXPOSURE)
            entity = sapien.Entity()
            entity.add_component(eye)
            self._scene.add_entity(entity)
            self._cameras[key] = entity, eye
        return self._cameras[key]

    def _place(self, links: _Array) -> None:
        for number, entity in self._links:
            pose = links[number]
            entity.set_pose(NativePose(pose[:3], pose[3:]))

    def _paint(self, colors: _Array) -> None:
        """Give shapes their links' colours (L, 4), where these have one."""
        for number, shape, own in self._painted:
            red, green, blue, holds = colors[number].tolist()
            color = (red, green, blue, own[3]) if holds > 0.0 else own
            for part in shape.parts if isinstance(shape, sapien.render.RenderShapeTriangleMesh) else [shape]:
                part.material.base_color = base_color(color)

    def _place_markers(self, poses: _Array | None) -> None:
        for number, entity in enumerate(self._markers):
            entity.set_pose(_AWAY if poses is None else NativePose(poses[number, :3], poses[number, 3:]))

    def free(self) -> None:
        self._cameras.clear()
        del self._links, self._markers, self._lights, self._scene, self._system


def _render_system() -> sapien.render.RenderSystem:
    try:
        return sapien.render.RenderSystem()
    except RuntimeError as error:
        raise ConfigurationError(
            f"SAPIEN cannot draw here, for no Vulkan driver fits ({str(error).strip()}): install the graphics card's "
            "driver (in a container without X, let VK_ICD_FILENAMES name it as libEGL_nvidia.so.0), or without a card "
            "libvulkan1 and Mesa's lavapipe of version 24 or later (on Debian 12: apt-get install -t "
            "bookworm-backports mesa-vulkan-drivers)"
        ) from error


def _looking_along_x(q: _Array) -> _Array:
    """SAPIEN's camera looks along +x with z up, the contract's along -z with y up: ``q`` after that turn."""
    w, x, y, z = (float(part) for part in q)
    a, b, c, d = 0.5, -0.5, 0.5, 0.5
    return np.array(
        [
            w * a - x * b - y * c - z * d,
            w * b + x * a + y * d - z * c,
            w * c - x * d + y * a + z * b,
            w * d + x * c - y * b + z * a,
        ],
        np.float32,
    )


def _bytes(color: _Array) -> npt.NDArray[np.uint8]:
    return (255.0 * np.clip(color, 0.0, 1.0) + 0.5).astype(np.uint8)
