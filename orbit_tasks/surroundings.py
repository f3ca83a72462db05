"""Rooms from files, procedural or scanned, that stand around a task."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from orbit_assets.audit.checks import shape_points
from orbit_assets.scene_files import load_scene
from orbit_core.interfaces import ConfigurationError
from orbit_core.scene import ObjectSpec, Pose, Scene
from orbit_core.scene.pose import FloatArray

# Metres by which a room may reach into what the task brings, for scans have noise.
_NOISE = 0.02
# Metres above the floor below which a shape of a room is its floor.
_FLOOR = 0.05


def surrounded(scene: Scene, file: str, place: tuple[float, float, float]) -> Scene:
    """Return a task's scene with the fixed objects of a room's file around it.

    The task keeps its own floor and lights; robots and what is loose in the file are left out.

    Args:
        scene: of the task.
        file: USD or MJCF file, such as ``orbit scene scan`` and ``orbit scene make`` write.
        place: x and y in m and heading in rad of the room's origin in the environment's frame.

    Raises:
        ConfigurationError: the file has no fixed object, or one where the task's own things stand.
        AssetError: the file cannot be read.
    """
    x, y, yaw = place
    at = Pose.from_euler(0.0, 0.0, yaw, (x, y, 0.0))
    taken = {entity.name for entity in scene.entities}
    room: list[ObjectSpec] = []
    for each in load_scene(file).objects:
        if each.fixed_base:
            name = each.name if each.name not in taken else f"room_{each.name}"
            taken.add(name)
            room.append(replace(each, name=name, pose=at @ each.pose))
    if not room:
        raise ConfigurationError(f"'{file}' has no fixed object, such as a wall, that could stand around a task")
    for own in scene.objects:
        _check_apart(own, room, file)
    return replace(scene, objects=(*scene.objects, *room))


def _check_apart(own: ObjectSpec, room: list[ObjectSpec], file: str) -> None:
    """Check that nothing of a room reaches into the box around an object of the task.

    Raises:
        ConfigurationError: something does.
    """
    for low, high in _bounds(own):
        for thing in room:
            for least, most in _bounds(thing):
                start, end = np.maximum(low, least), np.minimum(high, most)
                if most[2] > _FLOOR and (end - start > _NOISE).all():
                    raise ConfigurationError(
                        f"'{thing.name}' of '{file}' is where the task's '{own.name}' stands, at "
                        f"{np.round((start + end) / 2.0, 2).tolist()}: move the room by surroundings_place, or cut it "
                        "out of the scan (orbit_scenes.scan.cut_out)"
                    )


def _bounds(entity: ObjectSpec) -> list[tuple[FloatArray, FloatArray]]:
    """Return the boxes (low, high) around the root's collision shapes, in the environment's frame, m."""
    clouds = [entity.pose.transform(shape_points(shape)) for shape in entity.articulation.root.collisions]
    return [(cloud.min(0), cloud.max(0)) for cloud in clouds if len(cloud)]
