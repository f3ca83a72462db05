"""Edits of documents: functions that return another document, for :class:`~orbit_scenes.document.history.History`."""

from __future__ import annotations

import math
import re
from collections.abc import Collection, Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from orbit_core.interfaces.errors import ConfigurationError, PremiseError
from orbit_core.scene import Entity, ObjectSpec, Pose, SensorSpec
from orbit_core.scene.pose import Vector3
from orbit_scenes.certify import settled
from orbit_scenes.document.build import SceneBuilder
from orbit_scenes.document.files import check_sensor
from orbit_scenes.document.model import Item, JointChange, SceneDocument, check_name

# Metres by which things are put above what they stand on: meshes touch by rounding where they are flush.
_GAP = 0.001


def unique_name(document: SceneDocument, stem: str) -> str:
    """Return a name that no item or sensor has: ``stem``, or ``stem`` with the first number that is free."""
    stem = re.sub(r"\W", "_", stem) or "item"
    stem = f"_{stem}"[:56] if stem[0].isdigit() else stem[:56]
    taken = {thing.name for thing in (*document.items, *document.sensors)}
    if stem not in taken:
        return stem
    base = re.sub(r"_\d+$", "", stem)
    return next(name for number in range(2, len(taken) + 3) if (name := f"{base}_{number}") not in taken)


def add_item(document: SceneDocument, item: Item) -> SceneDocument:
    """Add an item."""
    return replace(document, items=(*document.items, item))


def replace_item(document: SceneDocument, item: Item) -> SceneDocument:
    """Replace the item of that name."""
    document.item(item.name)
    return replace(document, items=tuple(item if each.name == item.name else each for each in document.items))


def place(document: SceneDocument, name: str, pose: Pose) -> SceneDocument:
    """Move an item, or a camera that is fixed to the scene, to a pose."""
    if any(item.name == name for item in document.items):
        return replace_item(document, document.item(name).at(pose))
    return replace_sensor(document, name, pose=pose)


def change(document: SceneDocument, name: str, /, **changes: Any) -> SceneDocument:
    """Set fields of an item."""
    return replace_item(document, replace(document.item(name), **changes))


def change_joint(document: SceneDocument, name: str, joint: str, /, **changes: float | None) -> SceneDocument:
    """Set fields of the :class:`~orbit_scenes.document.model.JointChange` of an item's joint."""
    item = document.item(name)
    changed = replace(item.joints.get(joint, JointChange()), **changes)
    joints = {**item.joints, joint: changed}
    if changed == JointChange():
        del joints[joint]
    return replace_item(document, replace(item, joints=joints))


def add_sensor(document: SceneDocument, sensor: SensorSpec) -> SceneDocument:
    """Add a sensor."""
    check_sensor(sensor)
    return replace(document, sensors=(*document.sensors, sensor))


def replace_sensor(document: SceneDocument, which: str, /, **changes: Any) -> SceneDocument:
    """Set fields of a sensor's specification.

    Raises:
        ConfigurationError: the specification rejects a value, or has no such field.
    """
    try:
        changed = replace(document.sensor(which), **changes)
    except (TypeError, ValueError) as error:
        raise ConfigurationError(f"sensor '{which}': {error}") from None
    check_sensor(changed)
    return replace(document, sensors=tuple(changed if each.name == which else each for each in document.sensors))


def remove(document: SceneDocument, names: Collection[str]) -> SceneDocument:
    """Remove items and sensors, with the sensors on these items, and the task if it names one of them."""
    for name in names:
        _find(document, name)
    task = document.task
    if task is not None and {task.robot, *task.objects} & {*names}:
        # A task with fewer objects is still the task; one without its robot or any object is none.
        left = tuple(name for name in task.objects if name not in names)
        task = replace(task, objects=left) if left and task.robot not in names else None
    sensors = tuple(
        sensor for sensor in document.sensors if sensor.name not in names and _carrier(sensor) not in {*names}
    )
    return replace(
        document, items=tuple(item for item in document.items if item.name not in names), sensors=sensors, task=task
    )


def duplicate(document: SceneDocument, name: str, offset: Vector3 = (0.1, 0.0, 0.0)) -> tuple[SceneDocument, str]:
    """Copy an item or a sensor; return the document and the copy's name.

    Args:
        document: that holds it.
        name: of the item or the sensor.
        offset: metres from an item to its copy.
    """
    found, copy = _find(document, name), unique_name(document, name)
    if isinstance(found, SensorSpec):
        return add_sensor(document, replace(found, name=copy)), copy
    x, y, z = (start + step for start, step in zip(found.position, offset, strict=True))
    return add_item(document, replace(found, name=copy, position=(x, y, z))), copy


def rename(document: SceneDocument, old: str, new: str) -> SceneDocument:
    """Give an item or a sensor another name, also where sensors and the task name it.

    Raises:
        ConfigurationError: the name is taken, or none.
    """
    check_name(new)
    if any(thing.name == new for thing in (*document.items, *document.sensors)) and new != old:
        raise ConfigurationError(f"'{new}' is there already: give another name")
    if isinstance(_find(document, old), SensorSpec):
        return replace_sensor(document, old, name=new)
    task = document.task
    if task is not None:
        objects = tuple(new if name == old else name for name in task.objects)
        task = replace(task, robot=new if task.robot == old else task.robot, objects=objects)
    return replace(
        document,
        items=tuple(replace(item, name=new) if item.name == old else item for item in document.items),
        sensors=tuple(_renamed_carrier(sensor, old, new) for sensor in document.sensors),
        task=task,
    )


def _find(document: SceneDocument, name: str) -> Item | SensorSpec:
    return next((each for each in document.sensors if each.name == name), None) or document.item(name)


def _carrier(sensor: SensorSpec) -> str | None:
    return getattr(sensor, "entity", None)


def _renamed_carrier(sensor: SensorSpec, old: str, new: str) -> SensorSpec:
    changes: dict[str, Any] = {}
    if _carrier(sensor) == old:
        changes["entity"] = new
    if old in (filters := getattr(sensor, "filters", ())):
        changes["filters"] = tuple(new if name == old else name for name in filters)
    return replace(sensor, **changes) if changes else sensor


# Placing -------------------------------------------------------------------------------------------------------------


# Angle between places around the one that was asked for, and how much farther each is than the one before: a golden
# angle spreads them evenly.
_TURN, _STEP, _PLACES = 2.39996, 0.15, 120


def standing_near(document: SceneDocument, builder: SceneBuilder, item: Item, x: float, y: float, on: str = "") -> Item:
    """Return the item at the nearest place that is free: not on a robot, nor on what is free to move.

    Args:
        document: whose items may carry it.
        builder: of the document.
        item: to be placed; a robot stands on the ground, or on ``on``.
        x: of the place that is asked for, m.
        y: likewise.
        on: item that a person has chosen to carry it.
    """
    for number in range(_PLACES):
        away, angle = _STEP * math.sqrt(number), _TURN * number
        at = (round(x + away * math.cos(angle), 2), round(y + away * math.sin(angle), 2)) if number else (x, y)
        placed, support = _standing(document, builder, item, *at)
        carrier = document.item(support) if support else None
        sound = carrier is None or (builder.entity(carrier).fixed_base and not carrier.robot)
        if sound and (support in ("", on) or not item.robot):
            return placed
    return standing_at(document, builder, item, x, y)


def standing_at(document: SceneDocument, builder: SceneBuilder, item: Item, x: float, y: float) -> Item:
    """Return the item on the highest thing below a place, or on the ground.

    Args:
        document: whose items may carry it.
        builder: of the document.
        item: to be placed; its orientation stays.
        x: of the middle of its footprint, or of the root link of what is fixed, m.
        y: likewise.
    """
    return _standing(document, builder, item, x, y)[0]


def _standing(document: SceneDocument, builder: SceneBuilder, item: Item, x: float, y: float) -> tuple[Item, str]:
    """Return the item where :func:`standing_at` has it, and the name of what carries it; empty for the ground."""
    low, high = builder.bounds(item.at(Pose((0.0, 0.0, 0.0), item.orientation)))
    fixed = builder.entity(item).fixed_base
    middle = np.zeros(3) if fixed else (low + high) / 2.0
    left, right = low - middle + (x, y, 0.0), high - middle + (x, y, 0.0)
    height, support = document.ground or 0.0, ""
    for other in document.items:
        if other.name == item.name:
            continue
        below, above = builder.bounds(other)
        under = bool((below[:2] < right[:2]).all() and (left[:2] < above[:2]).all())
        if under and above[2] > height:
            height, support = float(above[2]), other.name
    # The mounting face of a fixed base is its frame's, whatever hangs below it, such as a table's legs.
    bottom = min(low[2], 0.0) if fixed else low[2] - _GAP
    # Whole tenths of a millimetre, so that a file has no digits that mean nothing.
    east, north, up = (round(float(part), 4) for part in (x - middle[0], y - middle[1], height - bottom))
    return item.at(Pose((east, north, up), item.orientation)), support


def snapped(pose: Pose, start: Pose, grid: float, angle: float) -> Pose:
    """Return a pose with its position on a grid, and turned from its start by a multiple of an angle.

    Args:
        pose: as a person dragged it.
        start: before the drag.
        grid: metres between places along each axis; zero leaves the position as it is.
        angle: radians between orientations; zero leaves the orientation as it is.
    """
    position = pose.position
    if grid > 0.0:
        # Only what was dragged: a thing that stands at 0.012 m keeps its height while it is moved sideways.
        x, y, z = (
            round(now / grid) * grid if abs(now - before) > 1e-6 else before
            for now, before in zip(pose.position, start.position, strict=True)
        )
        position = (x, y, z)
    turned = Pose(orientation=pose.orientation) @ Pose(orientation=start.orientation).inverse()
    w, axis = turned.orientation[0], np.array(turned.orientation[1:])
    length = float(np.linalg.norm(axis))
    if angle <= 0.0 or length < 1e-9:
        return Pose(position, pose.orientation)
    by = round(2.0 * math.atan2(length, w) / angle) * angle
    ax, ay, az = (float(part) for part in axis / length)
    whole = Pose.from_axis_angle((ax, ay, az), by) @ Pose(orientation=start.orientation)
    return Pose(position, whole.orientation)


def settle(
    document: SceneDocument, builder: SceneBuilder, names: Collection[str], backend: str, seconds: float = 5.0
) -> SceneDocument:
    """Let items drop until they rest, with everything else held where it is.

    Args:
        document: with the items where they start.
        builder: of the document.
        names: of the items.
        backend: name of an installed backend.
        seconds: most simulated time.

    Raises:
        PremiseError: an item leaves the scene.
        ConfigurationError: one of them cannot move.
    """
    scene = builder.scene(document)
    moved = {entity.name: entity for entity in scene.objects if entity.name in names and entity.is_free_body}
    if len(moved) != len({*names}):
        stuck = next(name for name in names if name not in moved)
        raise ConfigurationError(f"'{stuck}' does not fall: only rigid objects that are free to move settle")
    held = tuple(entity if entity.name in moved else _held(entity) for entity in scene.objects)
    rested = settled(replace(scene, objects=held), backend, seconds)
    for entity in rested.objects:
        if entity.name in moved:
            fell = moved[entity.name].pose.position[2] - entity.pose.position[2]
            if fell > 2.0 and not scene.terrain:
                raise PremiseError(f"'{entity.name}' falls {fell:.1f} m: there is no ground below it")
            document = place(document, entity.name, entity.pose)
    return document


def _held(entity: ObjectSpec) -> ObjectSpec:
    return replace(entity, fixed_base=True)


def kept(document: SceneDocument, states: Mapping[str, tuple[Pose, Mapping[str, float]]]) -> SceneDocument:
    """Return the document with items at the poses and joint positions of a simulation.

    Args:
        document: that was simulated.
        states: pose of the root link and positions of the joints, rad or m, by item.
    """
    for name, (pose, joints) in states.items():
        item = document.item(name)
        changes = {joint: replace(item.joints.get(joint, JointChange()), home=at) for joint, at in joints.items()}
        document = replace_item(document, replace(item.at(pose), joints={**item.joints, **changes}))
    return document


def free_items(entities: Collection[Entity]) -> tuple[str, ...]:
    """Return the names of the entities that :func:`settle` can let drop."""
    return tuple(each.name for each in entities if isinstance(each, ObjectSpec) and each.is_free_body)
