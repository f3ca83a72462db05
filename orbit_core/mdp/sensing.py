"""Observation terms of images and height scans."""

from __future__ import annotations

import copy
from collections.abc import Mapping
from dataclasses import replace
from typing import cast

from torch import Tensor

from orbit_core.envs.environment import Environment
from orbit_core.envs.observation_layout import POLICY, terms_of_group
from orbit_core.envs.task import Task
from orbit_core.envs.terms import Meaning, ObservationTerm
from orbit_core.interfaces import ConfigurationError, UnknownNameError, World
from orbit_core.scene import CameraSpec, Channel, RayCasterSpec
from orbit_core.sensors.camera import CameraSensor
from orbit_core.sensors.rays import RayCaster

# Observation terms of rays, each with the sensor that casts them ------------------------------------------------------


def height_scan(rays: RayCasterSpec) -> ObservationTerm:
    """(N, R) metres along each ray to what it hits; ``rays.max_distance`` where it hits nothing."""

    def distances(env: Environment) -> Tensor:
        return cast(RayCaster, env.world.sensors[rays.name]).distances.clamp(0.0, rays.max_distance)

    cast_from = [f"ray from ({x:g}, {y:g}, {z:g})" for x, y, z in rays.origins]
    formula = f"distance along each ray of '{rays.name}' to what it hits, {rays.max_distance:g} where it hits nothing"
    frame = "sensor: origins of the rays in its axes" + (", turned by the yaw of its link alone" * rays.yaw_only)
    meaning = Meaning(formula, frame, tuple(cast_from))
    return ObservationTerm(distances, sensors=(rays,), bounds=(0.0, rays.max_distance), unit="m", meaning=meaning)


# Observation terms of pictures, each with the camera that takes them, for groups with ``concatenate=False``.


def camera_color(camera: CameraSpec) -> ObservationTerm:
    """(N, H, W, 3) uint8, red, green and blue.

    Raises:
        ConfigurationError: the camera has no such channel.
    """
    return _picture(camera, Channel.RGB)


def camera_depth(camera: CameraSpec) -> ObservationTerm:
    """(N, H, W, 1) float32, metres along the optical axis; ``camera.far`` where nothing nearer is seen.

    Raises:
        ConfigurationError: the camera has no such channel.
    """
    _check_channel(camera, Channel.DEPTH)

    def depth(env: Environment) -> Tensor:
        return _camera(env.world, camera).image(Channel.DEPTH).clamp(0.0, camera.far)

    meaning = _meaning(camera, f"distance of each pixel along the optical axis, {camera.far:g} where nothing is seen")
    bounds = (0.0, camera.far)
    return ObservationTerm(depth, sensors=(camera,), bounds=bounds, camera=camera.name, unit="m", meaning=meaning)


def camera_segmentation(camera: CameraSpec, channel: Channel = Channel.SEMANTIC) -> ObservationTerm:
    """(N, H, W, 1) int32 of semantic labels, or of entities with ``Channel.INSTANCE``.

    Raises:
        ConfigurationError: the camera has no such channel, or it is no segmentation.
    """
    if channel not in (Channel.SEMANTIC, Channel.INSTANCE):
        raise ConfigurationError(f"channel {channel} is no segmentation: take Channel.SEMANTIC or Channel.INSTANCE")
    return _picture(camera, channel)


def with_cameras(task: Task, sizes: Mapping[str, tuple[int, int]]) -> None:
    """Let a task's policy see colour pictures of some cameras, and no other pictures.

    Where the policy does not see them, the task's observation preset that shows them is taken.

    Args:
        task: changed in place.
        sizes: width and height of the pictures, by the camera's name.

    Raises:
        UnknownNameError: neither the task's policy nor a preset sees a camera of that name in colour.
    """
    known: dict[str, None] = {}
    for preset in (lambda: task.observations, *task.observation_presets.values()):
        observations = copy.deepcopy(preset())
        group = getattr(observations, POLICY, None)
        terms = {} if group is None else terms_of_group(group)
        pictures = {name: term for name, term in terms.items() if term.camera is not None}
        colors = {str(term.camera): name for name, term in pictures.items() if _is_color(term)}
        known.update(dict.fromkeys(colors))
        if sizes.keys() <= colors.keys():
            for name in pictures:
                setattr(group, name, None)
            for camera, (width, height) in sizes.items():
                spec = cast(CameraSpec, pictures[colors[camera]].sensors[0])
                own = replace(spec, width=width, height=height, channels=(Channel.RGB,))
                setattr(group, colors[camera], camera_color(own))
            task.observations = observations
            return
    raise UnknownNameError("camera", next(iter(sizes.keys() - known.keys()), ""), known, f"task {type(task).__name__}")


def _is_color(term: ObservationTerm) -> bool:
    return term.meaning is not None and term.meaning.formula == _PICTURES[Channel.RGB]


def _picture(camera: CameraSpec, channel: Channel) -> ObservationTerm:
    _check_channel(camera, channel)
    picture = lambda env: _camera(env.world, camera).image(channel)  # noqa: E731
    meaning = _meaning(camera, _PICTURES[channel])
    return ObservationTerm(picture, sensors=(camera,), camera=camera.name, meaning=meaning)


_PICTURES = {
    Channel.RGB: "red, green and blue of each pixel, 0 to 255",
    Channel.SEMANTIC: "semantic label of each pixel",
    Channel.INSTANCE: "number of the entity in each pixel",
}


def _meaning(camera: CameraSpec, formula: str) -> Meaning:
    return Meaning(formula, f"camera '{camera.name}': rows from the top, columns from the left")


def _camera(world: World, camera: CameraSpec) -> CameraSensor:
    return cast(CameraSensor, world.sensors[camera.name])


def _check_channel(camera: CameraSpec, channel: Channel) -> None:
    if channel not in camera.channels:
        raise ConfigurationError(
            f"camera '{camera.name}' has no {channel.value} channel: add Channel.{channel.name} to its channels"
        )
