"""Additions of a world to its renderer's pictures: colours, textures, matter of other solvers, and axes of frames."""

from __future__ import annotations

import math
import weakref
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
import torch
from torch import Tensor

from orbit_core.backends import matter_names, matter_solver
from orbit_core.dynamics.indexing import take_rows, write_columns, write_rows
from orbit_core.dynamics.transforms import quat_from_matrix, quat_rotate_inverse
from orbit_core.installing import install_extra
from orbit_core.interfaces import Engine, Image, LightTable, Renderer, SceneLayout, UnsupportedCapabilityError
from orbit_core.interfaces.matter import LightView, MatterPainter, MatterSolver
from orbit_core.plugin_kit.meshes import marker_shapes
from orbit_core.plugin_kit.rendering import DeformableSurface
from orbit_core.scene import (
    Articulation,
    CameraSpec,
    Channel,
    Link,
    MarkerShape,
    MarkerSpec,
    RobotSpec,
    Scene,
    Shape,
    Texture,
)
from orbit_core.sensors.camera import intrinsic_matrix, point_cloud


# Renderers are wrapped, not changed, so that every backend's renderer gets the same additions.
class OuterRenderer(Renderer):
    """Hands all but pictures on to the renderer that it draws with."""

    def __init__(self, inner: Renderer) -> None:
        self._inner = inner
        self.capture = inner.capture
        self.most_samples = inner.most_samples

    def set_link_colors(self, colors: Tensor | None) -> None:
        super().set_link_colors(colors)
        self._inner.set_link_colors(colors)

    def set_lights(self, lights: LightTable | None) -> None:
        super().set_lights(lights)
        self._inner.set_lights(lights)

    def close(self) -> None:
        self._inner.close()


RESOLUTION = 256
"""Pixels of a texture's sides, to which all are brought."""
_WHERE = (Channel.DEPTH, Channel.NORMALS, Channel.INSTANCE)


@dataclass(frozen=True, eq=False)
class LinkTextures:
    """The textures of a world, and which of them each link has."""

    pixels: Tensor
    """(T * R * R, 3) in [0, 1]: of each texture its rows, the lowest first, of :data:`RESOLUTION` pixels."""
    scales: Tensor
    """(T, 2) pixels a metre, along the picture and up."""
    chosen: Tensor
    """(N, L) int64 which texture each link has in each environment; -1 for none."""
    across: Tensor
    """(3, 2) int64 the axes on which a texture lies, of a surface that faces along x, y or z."""

    @staticmethod
    def of(textures: Sequence[Texture], chosen: Tensor) -> LinkTextures:
        """Bring textures to one resolution, on the device of ``chosen`` (N, L)."""
        sheets: list[Tensor] = []
        for texture in textures:
            # Turned upside down: pictures begin at the top, and a surface's own axis points up.
            picture = torch.tensor(texture.pixels, dtype=torch.float32).flip(0).permute(2, 0, 1)[None] / 255.0
            sheet = torch.nn.functional.interpolate(picture, (RESOLUTION, RESOLUTION), mode="bilinear", antialias=True)
            sheets.append(sheet[0].permute(1, 2, 0).reshape(-1, 3))
        scales = [(RESOLUTION / texture.width, RESOLUTION / texture.height) for texture in textures]
        device = chosen.device
        across = torch.tensor(((1, 2), (0, 2), (0, 1)), device=device)
        return LinkTextures(torch.cat(sheets).to(device), torch.tensor(scales, device=device), chosen, across)

    def colors(self, which: Tensor, places: Tensor) -> Tensor:
        """Colours (..., 3) in [0, 1] of textures (...) at places (..., 2) in metres, blended from four pixels."""
        at = places * self.scales[which] + 0.5 * (RESOLUTION - 1)  # the middle at the frame's origin
        low = at.floor()
        right, up = (at - low).unbind(-1)
        column, row = low.long().unbind(-1)
        total = torch.zeros(*which.shape, 3, device=which.device)
        for along, across in ((0, 0), (1, 0), (0, 1), (1, 1)):
            weight = (right if along else 1.0 - right) * (up if across else 1.0 - up)
            # Textures repeat, so that one of any size covers a surface.
            pixel = ((row + across) % RESOLUTION) * RESOLUTION + (column + along) % RESOLUTION
            total += weight[..., None] * self.pixels[which * RESOLUTION**2 + pixel]
        return total


class TexturedRenderer(OuterRenderer):
    """Draws with another renderer, and paints textures where links have any."""

    def __init__(self, inner: Renderer) -> None:
        super().__init__(inner)
        self._textures: LinkTextures | None = None
        self._lenses: dict[tuple[CameraSpec, torch.device], Tensor] = {}

    def set_link_textures(self, textures: LinkTextures | None) -> None:
        """Paint these from now on; the owner of ``chosen`` writes it in place."""
        self._textures = textures

    def render(
        self,
        camera: CameraSpec,
        camera_poses: Tensor,
        link_poses: Tensor,
        channels: Sequence[Channel],
        marker_poses: Tensor | None = None,
        env_ids: Tensor | None = None,
    ) -> Image:
        textures = self._textures
        if textures is None or not {Channel.RGB, Channel.ALBEDO} & {*channels}:
            return self._inner.render(camera, camera_poses, link_poses, channels, marker_poses, env_ids)
        asked = tuple(dict.fromkeys((*channels, *_WHERE)))
        image = self._inner.render(camera, camera_poses, link_poses, asked, marker_poses, env_ids)
        chosen = take_rows(textures.chosen, env_ids)[: len(link_poses)]
        lens = self._lens(camera, link_poses.device)
        share = _shares(textures, chosen, lens, camera_poses, link_poses, image)
        kept = image.only(channels)
        colors = {"rgb": kept.rgb, "albedo": kept.albedo}
        return replace(
            kept,
            **{name: (each * share + 0.5).to(torch.uint8) for name, each in colors.items() if each is not None},
        )

    def _lens(self, camera: CameraSpec, device: torch.device) -> Tensor:
        """(3, 3) in pixels, made once, for a captured step copies nothing to its device."""
        if (camera, device) not in self._lenses:
            self._lenses[camera, device] = intrinsic_matrix(camera).to(device)
        return self._lenses[camera, device]


def _shares(
    textures: LinkTextures, chosen: Tensor, lens: Tensor, eyes: Tensor, link_poses: Tensor, image: Image
) -> Tensor:
    """(n, H, W, 3) in [0, 1]: what is left of each pixel's colour."""
    depth, normals, links = image.depth, image.normals, image.links
    assert depth is not None  # all three were asked for
    assert normals is not None
    assert links is not None
    device, flat = link_poses.device, links.to(link_poses.device, torch.int64).flatten(1)
    seen = flat.clamp_min(0)
    which = torch.where(flat >= 0, chosen.gather(1, seen), -1).view(links.shape[:3])
    poses = link_poses.gather(1, seen[..., None].expand(-1, -1, 7)).view(*which.shape, 7)
    points = point_cloud(depth.to(device), lens, eyes)
    places = quat_rotate_inverse(poses[..., 3:], torch.where(points.isfinite(), points, 0.0) - poses[..., :3])
    # The picture is projected along the axis that the surface faces most: no shape needs texture coordinates.
    facing = quat_rotate_inverse(poses[..., 3:], normals.to(device)).abs().argmax(-1)
    places = places.gather(-1, textures.across[facing])
    colors = textures.colors(which.clamp_min(0), places)
    return torch.where((which >= 0)[..., None], colors, 1.0)


class Painting:
    """Links' own colours and textures, of N environments, and the renderers that draw them.

    Args:
        num_envs: N.
        links: L, of the scene.
        device: where colours lie.
    """

    def __init__(self, num_envs: int, links: int, device: torch.device) -> None:
        self._shape, self._device = (num_envs, links, 4), device
        self._colors: Tensor | None = None
        self._known: list[Texture] = []
        # Of textures that were given together, made once, so that a captured step copies nothing to its device
        self._numbers: dict[tuple[Texture, ...], Tensor] = {}
        self._chosen: Tensor | None = None
        self.textures: LinkTextures | None = None
        """What renderers paint; None while nothing has a texture."""
        # Weak, because a camera that nobody holds any more must not keep its renderer alive.
        self._renderers: weakref.WeakSet[TexturedRenderer] = weakref.WeakSet()
        self._lit: weakref.WeakSet[Renderer] = weakref.WeakSet()
        self._lights: LightTable | None = None

    def add(self, renderer: Renderer, wrap: Callable[[Renderer], Renderer] | None = None) -> Renderer:
        """Return a renderer that draws what this one draws, with the colours, textures and lights.

        Args:
            renderer: draws.
            wrap: makes another renderer of the one that has the colours and textures; lights go to it.
        """
        textured = TexturedRenderer(renderer)
        self._renderers.add(textured)
        textured.set_link_colors(self._colors)
        textured.set_link_textures(self.textures)
        outer = textured if wrap is None else wrap(textured)
        self._lit.add(outer)
        outer.set_lights(self._lights)
        return outer

    def light(self, own: LightTable, lights: LightTable, env_ids: Tensor | None) -> None:
        """Give some environments lights of their own.

        Args:
            own: the scene's lights, for environments that were given none yet.
            lights: of the environments (n, ...), at most as many directional ones as the scene has.
            env_ids: which ones.
        """
        if self._lights is None:
            self._lights = own
            for renderer in self._lit:
                renderer.set_lights(own)
        for table, values in (
            (self._lights.ambient, lights.ambient),
            (self._lights.directions, lights.directions),
            (self._lights.radiance, lights.radiance),
        ):
            write_rows(table, values, env_ids)

    def paint(self, links: Tensor, colors: Tensor, env_ids: Tensor | None) -> None:
        """Give links (k,) colours (n, k, 3) in some environments."""
        if self._colors is None:
            self._colors = torch.zeros(self._shape, device=self._device)
            for renderer in self._renderers:
                renderer.set_link_colors(self._colors)
        # The fourth component says that the link has a colour at all; it is no opacity.
        holding = torch.cat((colors, torch.ones_like(colors[..., :1])), dim=-1)
        write_columns(self._colors, links, holding, env_ids)

    def texture(self, links: Tensor, textures: Sequence[Texture], chosen: Tensor, env_ids: Tensor | None) -> None:
        """Give links (k,) one of the textures each, by index (n, k) int64, or none by -1, in some environments."""
        if self._chosen is None:
            self._chosen = torch.full(self._shape[:2], -1, dtype=torch.int64, device=self._device)
        choices = tuple(textures)
        if choices not in self._numbers:
            self._numbers[choices] = self._learned(choices, self._chosen)
        write_columns(self._chosen, links, self._numbers[choices][chosen], env_ids)

    def _learned(self, textures: Sequence[Texture], chosen: Tensor) -> Tensor:
        """Have renderers know these textures; (k + 1,) their numbers among all that are known, then -1 for none."""
        if new := [texture for texture in textures if texture not in self._known]:
            self._known += new
            self.textures = LinkTextures.of(self._known, chosen)
            for renderer in self._renderers:
                renderer.set_link_textures(self.textures)
        return torch.tensor([*(self._known.index(texture) for texture in textures), -1], device=self._device)


# Metres between a light's camera and deformables: rays of 0.5 m to the side lean by 0.7 degrees.
_AWAY = 40.0
# Metres before and behind deformables within which shadows are cast.
_DEEP = 3.0
# Most pixels of a light's camera along its sides.
_FINE = 256


def light_camera(layout: SceneLayout, cameras: Sequence[CameraSpec]) -> CameraSpec | None:
    """Return the camera that shows deformables as a light meets them; None where no picture has their shadows."""
    if not layout.scene.deformables or not any(light.shadows for light in layout.scene.directional_lights):
        return None
    # A small picture needs no finer shadows than its own pixels.
    sides = [max(camera.width, camera.height) for camera in cameras if Channel.RGB in camera.channels]
    if not sides:
        return None
    points = np.concatenate([spec.pose.transform(spec.rest_positions) for spec in layout.scene.deformables])
    reach = float(np.linalg.norm(points - points.mean(axis=0), axis=1).max())
    # Half as wide again, for what spreads or falls apart.
    fov, side = 2.0 * math.atan(max(1.5 * reach, 0.2) / _AWAY), min(_FINE, *sides)
    return CameraSpec(
        name="light", width=side, height=side, vertical_fov=fov, near=_AWAY - _DEEP, far=_AWAY + _DEEP,
        channels=(Channel.DEPTH,),
    )  # fmt: skip


def with_matter(
    renderer: Renderer,
    solver: MatterSolver | None,
    engine: Engine,
    layout: SceneLayout,
    light: CameraSpec | None = None,
) -> Renderer:
    """The renderer, with the scene's deformables painted into its pictures if there are any.

    Their solver paints them; those of the engine's own, without a ``solver``, any that is installed and can.

    Args:
        renderer: that draws all else, also for ``light``.
        solver: of the deformables.
        engine: that they are read from.
        layout: of the scene.
        light: camera of :func:`light_camera`; without one there are no shadows of deformables, and none on them.

    Raises:
        UnsupportedCapabilityError: nothing that is installed paints them.
    """
    if not layout.scene.deformables:
        return renderer
    solvers = [solver] if solver is not None else map(matter_solver, matter_names())
    reasons = [f"no matter solver is installed: {install_extra('matter')}"]
    for each in solvers:
        try:
            return MatterRenderer(renderer, each.create_painter(layout, engine.device), engine, layout, light)
        except UnsupportedCapabilityError as error:
            reasons = [*reasons[1:], str(error)]
    raise UnsupportedCapabilityError(f"pictures of deformables need a matter solver that paints: {'; '.join(reasons)}")


def scene_lights(scene: Scene, rows: int, device: torch.device) -> LightTable:
    """Return a scene's own lights for each of so many environments."""
    lamps = scene.directional_lights
    directions = torch.tensor([lamp.unit_direction for lamp in lamps], device=device).reshape(-1, 3)
    radiance = torch.tensor([lamp.radiance for lamp in lamps], device=device).reshape(-1, 3)
    ambient = torch.tensor(scene.ambient, dtype=torch.float32, device=device)
    return LightTable(ambient.expand(rows, 3), directions.expand(rows, -1, 3), radiance.expand(rows, -1, 3))


class MatterRenderer(OuterRenderer):
    """Renderer that draws with another one, with depth, and paints deformables over the shapes behind them."""

    def __init__(
        self,
        inner: Renderer,
        painter: MatterPainter,
        engine: Engine,
        layout: SceneLayout,
        light: CameraSpec | None = None,
    ) -> None:
        super().__init__(inner)
        self._painter, self._engine, self._eye = painter, engine, light
        self._surfaces = [DeformableSurface(spec) for spec in layout.scene.deformables]
        lamps = layout.scene.directional_lights
        self._shadowing = [index for index, lamp in enumerate(lamps) if lamp.shadows]
        self._own = scene_lights(layout.scene, 1, engine.device)

    def render(
        self,
        camera: CameraSpec,
        camera_poses: Tensor,
        link_poses: Tensor,
        channels: Sequence[Channel],
        marker_poses: Tensor | None = None,
        env_ids: Tensor | None = None,
    ) -> Image:
        casts = Channel.RGB in channels and self._eye is not None
        extra = (Channel.DEPTH, Channel.NORMALS, Channel.ALBEDO) if casts else (Channel.DEPTH,)
        asked = tuple(dict.fromkeys((*channels, *extra)))
        image = self._inner.render(camera, camera_poses, link_poses, asked, marker_poses, env_ids)
        count = len(camera_poses)
        shown = [
            surface.vertices(take_rows(self._engine.particle_positions(index), env_ids)[:count])
            for index, surface in enumerate(self._surfaces)
        ]
        lights = self._lights_of(count, env_ids)
        views = list(self._views(shown, lights, link_poses, env_ids)) if casts else []
        return self._painter.paint(camera, camera_poses, shown, image, lights, views).only(channels)

    def _lights_of(self, count: int, env_ids: Tensor | None) -> LightTable:
        """Return the lights of ``count`` environments."""
        own, given = self._own, self.lights
        if given is None:
            return LightTable(
                own.ambient.expand(count, -1), own.directions.expand(count, -1, -1), own.radiance.expand(count, -1, -1)
            )
        tables = (given.ambient, given.directions, given.radiance)
        return LightTable(*(take_rows(table, env_ids)[:count] for table in tables))

    def _views(
        self, shown: Sequence[Tensor], lights: LightTable, link_poses: Tensor, env_ids: Tensor | None
    ) -> Iterator[LightView]:
        """Yield the links (n, L, 7) as each light meets them, around deformables' vertices (n, V, 3) each."""
        assert self._eye is not None
        middle = torch.cat(tuple(shown), dim=1).mean(1)
        for index in self._shadowing:
            way = lights.directions[:, index]
            poses = torch.cat((middle - _AWAY * way, _looking_along(way)), dim=1)
            image = self._inner.render(self._eye, poses, link_poses, (Channel.DEPTH,), None, env_ids)
            assert image.depth is not None
            yield LightView(index, self._eye, poses, image.depth)


def _looking_along(ways: Tensor) -> Tensor:
    """Return orientations (n, 4) of cameras that look along unit vectors (n, 3)."""
    axes = torch.eye(3, dtype=ways.dtype, device=ways.device)
    # Along the vertical any direction will do for up.
    steep = ways[:, 2:].abs() > 0.999
    right = torch.linalg.cross(torch.where(steep, axes[1], axes[2]), -ways)
    right = right / right.norm(dim=1, keepdim=True)
    return quat_from_matrix(torch.stack((right, torch.linalg.cross(-ways, right), -ways), dim=-1))


_OPAQUE = (0.0, 0.0, 0.0, 1.0)
# Lengths of axes in metres: of the base, of end effectors, feet and wheels, and of finger tips
_BASE, _LARGE, _SMALL = 0.25, 0.12, 0.04


def frame_lengths(robot: RobotSpec) -> dict[str, float]:
    """Names of the links and frames whose axes are drawn, each with the axes' length in metres."""
    tips = [tip for effector in robot.end_effectors for tip in effector.finger_tips]
    large = [*(effector.frame for effector in robot.end_effectors), *robot.feet, *robot.wheels]
    return {robot.base_link: _BASE} | dict.fromkeys(tips, _SMALL) | dict.fromkeys(large, _LARGE)


def frame_shapes(robot: RobotSpec) -> dict[str, tuple[Shape, ...]]:
    """The axes as shapes, in the frame of the link that they are fixed to, by that link's name.

    x is red, y green and z blue.
    """
    shapes: dict[str, tuple[Shape, ...]] = {}
    for name, length in frame_lengths(robot).items():
        frame = robot.articulation.frame(name)
        axes = marker_shapes(MarkerSpec(name, MarkerShape.FRAME, length, _OPAQUE))
        placed = tuple(replace(axis, pose=frame.pose @ axis.pose) for axis in axes)
        shapes[frame.link] = (*shapes.get(frame.link, ()), *placed)
    return shapes


def with_frames(layout: SceneLayout) -> SceneLayout:
    """The layout with the robots' axes among what is seen of their links; what collides and moves is the same."""
    robots = tuple(replace(robot, articulation=_marked(robot)) for robot in layout.scene.robots)
    return SceneLayout.of(replace(layout.scene, robots=robots))


def _marked(robot: RobotSpec) -> Articulation:
    axes = frame_shapes(robot)

    def links() -> Iterator[Link]:
        for link in robot.articulation.links:
            seen = link.visuals or link.collisions
            yield replace(link, visuals=(*seen, *axes[link.name])) if link.name in axes else link

    return replace(robot.articulation, links=tuple(links()))
