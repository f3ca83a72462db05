"""Scenes dressed for a spectator, and pictures of them that are averaged over samples.

A studio lays textures on what the scene leaves plain, lights it softly, and averages several pictures of each moment,
with the camera moved within a pixel and the lights within their width. Cameras of the scene see nothing of it, so that
what a policy learned from stays as it is.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import torch
from torch import Tensor

from orbit_core.dynamics.transforms import quat_multiply
from orbit_core.interfaces import Image, LightTable, Renderer, SceneLayout
from orbit_core.scene import (
    Articulation,
    CameraSpec,
    Channel,
    Color,
    Entity,
    Finish,
    HeightField,
    Mesh,
    Plane,
    RobotSpec,
    Scene,
    Shape,
    Studio,
)
from orbit_core.scene.patterns import concrete, grid, wood
from orbit_core.scene.shapes import DULL
from orbit_core.world.drawing import OuterRenderer, scene_lights

# Fractional parts of multiples of these fill a square evenly (Roberts, The R2 sequence, 2018).
_PLASTIC = (0.7548776662466927, 0.5698402909980532)
_GOLDEN_ANGLE = math.pi * (3.0 - math.sqrt(5.0))
# Number of pictures from which lights have their full width.
_FULL = 16
_FLOOR: Color = (0.80, 0.81, 0.83, 1.0)
_EARTH: Color = (0.74, 0.71, 0.66, 1.0)


def dressed(layout: SceneLayout, studio: Studio) -> SceneLayout:
    """Return the layout with the studio's lights and sky, and textures and highlights where the scene has none."""
    scene, plain = layout.scene, Scene()
    lights = studio.lights if scene.lights == plain.lights else scene.lights
    sky = studio.sky if scene.sky == plain.sky else scene.sky
    robots = tuple(replace(robot, articulation=_finished(robot.articulation, robot)) for robot in scene.robots)
    objects = tuple(
        replace(
            thing,
            articulation=_finished(thing.articulation, thing),
            variants=tuple(_finished(variant, thing) for variant in thing.variants),
        )
        for thing in scene.objects
    )
    terrain = tuple(_ground(shape) for shape in scene.terrain)
    return SceneLayout.of(replace(scene, robots=robots, objects=objects, terrain=terrain, lights=lights, sky=sky))


def _ground(shape: Shape) -> Shape:
    if shape.finish != DULL:
        return shape
    if isinstance(shape.geometry, Plane):
        return replace(shape, color=_FLOOR, finish=Finish(texture=grid()))
    # Slabs around a terrain continue it.
    if isinstance(shape.geometry, HeightField | Mesh) or shape.name.startswith("border"):
        return replace(shape, color=_EARTH, finish=Finish(texture=grid()))
    return replace(shape, color=_lighter(shape.color), finish=Finish(texture=concrete()))


def _finished(articulation: Articulation, entity: Entity) -> Articulation:
    robot = isinstance(entity, RobotSpec)
    links = (
        replace(link, visuals=tuple(_surface(shape, robot) for shape in link.visuals or link.collisions))
        for link in articulation.links
    )
    return replace(articulation, links=tuple(links))


def _surface(shape: Shape, robot: bool) -> Shape:
    if shape.finish != DULL:
        return shape
    red, green, blue, opacity = shape.color
    # What is brown, and not red, is taken for wood, and never a robot.
    brown = not robot and opacity == 1.0 and red > 1.15 * green > 1.3 * blue and blue > 0.12 and green > 0.4 * red
    if brown:
        return replace(shape, color=_lighter(shape.color), finish=Finish(roughness=0.8, texture=wood()))
    return replace(shape, finish=Finish(roughness=0.55 if robot else 0.65))


def _lighter(color: Color) -> Color:
    """Return a colour that a texture, which darkens it, brings back to where it was."""
    red, green, blue, opacity = color
    return (min(1.12 * red, 1.0), min(1.12 * green, 1.0), min(1.12 * blue, 1.0), opacity)


class StudioRenderer(OuterRenderer):
    """Renderer that averages colour pictures of another one over a pixel's area and the lights' width.

    Args:
        inner: draws each picture.
        scene: whose lights hold where environments have none of their own.
        studio: says how many pictures, and how wide the lights are.
    """

    def __init__(self, inner: Renderer, scene: Scene, studio: Studio) -> None:
        super().__init__(inner)
        self._studio, self._scene = studio, scene
        most = inner.most_samples
        self._samples = studio.samples if most is None else min(studio.samples, most)
        self._own: LightTable | None = None

    def set_lights(self, lights: LightTable | None) -> None:
        # Not handed on: each picture is drawn in lights that are turned a little.
        self._own = lights

    def render(
        self,
        camera: CameraSpec,
        camera_poses: Tensor,
        link_poses: Tensor,
        channels: Sequence[Channel],
        marker_poses: Tensor | None = None,
        env_ids: Tensor | None = None,
    ) -> Image:
        samples = self._samples
        first = self._sample(0, camera, camera_poses, link_poses, channels, marker_poses, env_ids)
        if first.rgb is None or samples == 1:
            return first
        total = first.rgb.to(torch.float32)
        for number in range(1, samples):
            image = self._sample(number, camera, camera_poses, link_poses, (Channel.RGB,), marker_poses, env_ids)
            assert image.rgb is not None  # it was asked for
            total += image.rgb
        return replace(first, rgb=(total / samples + 0.5).to(torch.uint8))

    def _sample(
        self,
        number: int,
        camera: CameraSpec,
        camera_poses: Tensor,
        link_poses: Tensor,
        channels: Sequence[Channel],
        marker_poses: Tensor | None,
        env_ids: Tensor | None,
    ) -> Image:
        poses = camera_poses if number == 0 else _within_pixel(camera, camera_poses, number)
        self._inner.set_lights(self._lights(number, int(link_poses.shape[0]), env_ids, link_poses.device))
        return self._inner.render(camera, poses, link_poses, channels, marker_poses, env_ids)

    def _lights(self, number: int, count: int, env_ids: Tensor | None, device: torch.device) -> LightTable:
        lamps = len(self._scene.directional_lights)
        if self._own is None:
            own = scene_lights(self._scene, self._rows(count, env_ids), device)
        else:
            own = _of_length(self._own, lamps)
        samples = self._samples
        # Few pictures in wide light would show as steps at the edges of shadows.
        width = self._studio.softness * min(1.0, math.sqrt(samples / _FULL))
        radius = width * math.sqrt((number + 0.5) / samples) if samples > 1 else 0.0
        angle = _GOLDEN_ANGLE * number
        return LightTable(own.ambient, _turned(own.directions, radius, angle), own.radiance)

    def _rows(self, count: int, env_ids: Tensor | None) -> int:
        # Tables have a row for each environment, and pictures may be of the last ones.
        return count if env_ids is None else max(count, int(env_ids.max()) + 1)


def _of_length(lights: LightTable, lamps: int) -> LightTable:
    """Return lights with as many directional ones as a renderer has, dark ones where the table has fewer."""
    missing = max(0, lamps - int(lights.directions.shape[1]))
    # Any direction will do for a light that is off, but none of length zero.
    dark = lights.directions.new_tensor((0.0, 0.0, -1.0)).expand(len(lights.directions), missing, 3)
    directions = torch.cat((lights.directions[:, :lamps], dark), dim=1)
    return LightTable(lights.ambient, directions, torch.cat((lights.radiance[:, :lamps], 0.0 * dark), dim=1))


def _within_pixel(camera: CameraSpec, poses: Tensor, number: int) -> Tensor:
    """Return camera poses (n, 7) turned by less than a pixel, another way for each number."""
    focal = 0.5 * camera.height / math.tan(0.5 * camera.vertical_fov)
    across, up = ((0.5 + number * part) % 1.0 - 0.5 for part in _PLASTIC)
    # Half angles, small enough that their sines are themselves.
    turn = torch.tensor((1.0, 0.5 * up / focal, 0.5 * across / focal, 0.0), device=poses.device)
    turned = quat_multiply(poses[:, 3:], (turn / turn.norm()).expand(len(poses), 4))
    return torch.cat((poses[:, :3], turned), dim=-1)


def _turned(directions: Tensor, radius: float, angle: float) -> Tensor:
    """Return unit vectors (..., 3) that are turned by ``radius`` toward an angle about themselves."""
    if radius == 0.0:
        return directions
    least = torch.nn.functional.one_hot(directions.abs().argmin(-1), 3).to(directions.dtype)
    first = torch.nn.functional.normalize(torch.linalg.cross(directions, least), dim=-1)
    second = torch.linalg.cross(directions, first)
    moved = directions + radius * (math.cos(angle) * first + math.sin(angle) * second)
    return torch.nn.functional.normalize(moved, dim=-1)
