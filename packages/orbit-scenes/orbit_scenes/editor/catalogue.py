"""Catalogue with search of all that can be added to a scene: robots, things, furniture, objects and sensors."""

from __future__ import annotations

import functools
import math
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass
from enum import Enum

from orbit_assets.catalogue import robot_info, robots
from orbit_core.interfaces.errors import ConfigurationError, OrbitError
from orbit_core.objects import object_kinds
from orbit_core.registry import first_line
from orbit_core.scene import (
    CameraSpec,
    ContactSensorSpec,
    Entity,
    EventCameraSpec,
    ForceTorqueSpec,
    FrameSensorSpec,
    ImuSpec,
    JointSensorSpec,
    Pose,
    RayCameraSpec,
    RayCasterSpec,
    RobotSpec,
    SensorSpec,
    TactileSpec,
)
from orbit_scenes.document.files import SENSORS
from orbit_scenes.document.model import Item
from orbit_scenes.furniture import furniture_kinds, furniture_table
from orbit_scenes.things import thing_names, thing_table


class Group(Enum):
    """A kind of entry, by its heading."""

    ROBOT = "Robots"
    """Robots of the catalogue, and compositions of their parts."""
    THING = "Things"
    """Household things of the library."""
    FURNITURE = "Furniture"
    """Furniture of the library."""
    OBJECT = "Other objects"
    """Solids and other kinds of objects, those of installed packages included."""
    SENSOR = "Sensors"
    """Cameras and other sensors."""


@dataclass(frozen=True)
class Entry:
    """One thing that can be added."""

    group: Group
    """Heading that it stands under."""
    name: str
    """Name within its group."""
    words: str
    """One line about it."""

    def item(self, name: str) -> Item:
        """Return an item of this source.

        Args:
            name: of the item.

        Raises:
            ConfigurationError: a sensor is no item.
        """
        if self.group is Group.ROBOT:
            return Item(name=name, robot=self.name)
        if self.group is Group.THING:
            return Item(name=name, object="thing", parameters={"thing": self.name})
        if self.group is Group.FURNITURE:
            return Item(name=name, object="furniture", parameters={"furniture": self.name})
        if self.group is Group.OBJECT:
            return Item(name=name, object=self.name)
        raise ConfigurationError(f"'{self.name}' is a sensor, which no item is")


_SENSOR_WORDS = {
    "camera": "pictures from a place, or from a link",
    "contact": "contact forces on links",
    "event_camera": "changes of brightness in a picture",
    "force_torque": "wrench through a joint",
    "frame": "pose and velocity of a link or frame",
    "imu": "angular velocity and acceleration",
    "joints": "joint positions and velocities",
    "ray_camera": "depth and segmentation by rays, without a renderer",
    "ray_caster": "distances along rays",
    "tactile": "taxels on a pad",
}


@functools.cache
def entries() -> tuple[Entry, ...]:
    """Return all entries; nothing is built."""
    found = [Entry(Group.ROBOT, name, entry.description) for name, entry in sorted(robots().entries.items())]
    things = thing_table()
    found += [Entry(Group.THING, name, f"{things[name].mass:g} kg") for name in thing_names()]
    table = furniture_table()
    found += [Entry(Group.FURNITURE, kind, _size(table[kind].size)) for kind in furniture_kinds()]
    for name in object_kinds().names:
        # These two stand under headings of their own; a mesh needs a file, which the file's own table names.
        if name in ("thing", "furniture", "mesh"):
            continue
        try:
            found.append(Entry(Group.OBJECT, name, first_line(object_kinds().get(name))))
        except OrbitError:
            # A broken package hides only its own kinds; 'orbit list objects' says why.
            continue
    return (*found, *(Entry(Group.SENSOR, kind, _SENSOR_WORDS[kind]) for kind in SENSORS))


def search(query: str, group: Group | None = None) -> tuple[Entry, ...]:
    """Return entries in which all words of a query occur, those whose names begin with the first word first.

    Args:
        query: words; a name with plus signs is a composition of robots.
        group: heading to search under; None searches all.
    """
    words = query.lower().replace("_", " ").split()
    known = [each for each in entries() if group in (None, each.group)]
    if "+" in query and group in (None, Group.ROBOT):
        with suppress(OrbitError):  # incomplete while it is typed
            known.append(Entry(Group.ROBOT, query.strip(), robot_info(query.strip()).description))
    found = [each for each in known if all(word in _text(each) for word in words)]
    if not words:
        return tuple(found)
    # Sorting is stable: equally good ones stay under their headings.
    return tuple(sorted(found, key=lambda each: (not each.name.startswith(words[0]), words[0] not in each.name)))


def _text(entry: Entry) -> str:
    return f"{entry.name.replace('_', ' ')} {entry.words} {entry.group.value}".lower()


def _size(size: Sequence[float]) -> str:
    return " x ".join(f"{length:.2f}" for length in size) + " m"


def sensor_for(kind: str, name: str, carrier: Entity | None, view: Pose) -> SensorSpec:
    """Return a sensor with values that work at once.

    Args:
        kind: of :data:`~orbit_scenes.document.files.SENSORS`.
        name: of the sensor.
        carrier: robot or object that it is on; None for a camera that is fixed to the scene.
        view: pose of such a camera.

    Raises:
        ConfigurationError: the sensor needs a carrier, and there is none.
    """
    cameras = {"camera": CameraSpec, "event_camera": EventCameraSpec, "ray_camera": RayCameraSpec}
    if kind in cameras:
        return cameras[kind](name=name, pose=view, width=320, height=240)
    if carrier is None:
        raise ConfigurationError(f"select the robot or object that the sensor '{kind}' is on, then add it")
    owner, root = carrier.name, carrier.articulation.root.name
    frame = carrier.end_effector.frame if isinstance(carrier, RobotSpec) and carrier.end_effectors else root
    link = next((each.link for each in carrier.articulation.frames if each.name == frame), frame)
    made: dict[str, SensorSpec] = {
        "contact": ContactSensorSpec(name=name, entity=owner),
        "force_torque": ForceTorqueSpec(name=name, entity=owner, link=link),
        "frame": FrameSensorSpec(name=name, entity=owner, frame=frame),
        "imu": ImuSpec(name=name, entity=owner, frame=frame),
        "joints": JointSensorSpec(name=name, entity=owner),
        "ray_caster": RayCasterSpec(name=name, entity=owner, frame=frame, directions=_fan(36)),
        "tactile": TactileSpec(name=name, entity=owner, links=(link,), frame=frame),
    }
    return made[kind]


def _fan(count: int) -> tuple[tuple[float, float, float], ...]:
    angles = (2.0 * math.pi * number / count for number in range(count))
    return tuple((round(math.cos(angle), 6), round(math.sin(angle), 6), 0.0) for angle in angles)
