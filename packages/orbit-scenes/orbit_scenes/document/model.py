"""Document of an authored scene: what a person placed and changed, as frozen dataclasses that are the file's schema.

An item names where its articulation comes from (the robots' catalogue, a kind of object, or an entity of a USD or MJCF
file) and lists what differs from it, so that a file stays short and follows later versions of the catalogue.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any

from orbit_core.interfaces.errors import ConfigurationError, UnknownNameError
from orbit_core.scene import AmbientLight, DirectionalLight, Pose, SensorSpec, Sky
from orbit_core.scene.pose import Quaternion, Vector3
from orbit_core.scene.scene import Rgb

MOST_ITEMS, MOST_SENSORS = 1000, 100
"""Largest numbers of items and sensors of a document; a file with more is refused before anything is built."""
# USD's names of prims, so that a document and a scene written from it have the same names.
_NAME = re.compile(r"[A-Za-z_][A-Za-z0-9_]{0,63}")


@dataclass(frozen=True, kw_only=True)
class JointChange:
    """Differences of a joint from the source's; None leaves a value as it is."""

    lower: float | None = None
    """Lower limit, rad or m."""
    upper: float | None = None
    """Upper limit, rad or m."""
    home: float | None = None
    """Position at reset, rad or m."""
    stiffness: float | None = None
    """Gain of the drive, N m/rad or N/m."""
    damping: float | None = None
    """Gain of the drive for velocities, N m s/rad or N s/m."""
    effort: float | None = None
    """Limit of the drive's effort, N m or N."""


@dataclass(frozen=True, kw_only=True)
class Item:
    """A robot or an object of a document. Exactly one of ``robot``, ``object`` and ``file`` names its source.

    Raises:
        ConfigurationError: the name is no name, or there is no source or more than one.
    """

    name: str
    """Unique in the scene: letters, digits and underscores."""
    robot: str = ""
    """Name in the catalogue of robots, or a composition such as ``"ur10+robotiq_2f85"``."""
    object: str = ""
    """Kind of object (``orbit list objects``)."""
    file: str = ""
    """USD or MJCF file in the document's folder."""
    entity: str = ""
    """Name of the entity in ``file``."""
    parameters: Mapping[str, Any] = field(default_factory=dict)
    """Parameters of the kind of object, by path."""
    position: Vector3 = (0.0, 0.0, 0.0)
    """Position of the root link, m."""
    orientation: Quaternion = (1.0, 0.0, 0.0, 0.0)
    """Orientation of the root link, a unit quaternion (w, x, y, z)."""
    fixed: bool | None = None
    """True if the root link cannot move; None leaves it as it is."""
    mass: float | None = None
    """Mass of all links together, kg; inertias are scaled with it. None leaves it as it is."""
    friction: float | None = None
    """Static and dynamic friction of all collision shapes; None leaves them as they are."""
    color: Rgb | None = None
    """Colour of all visual shapes; None leaves them as they are."""
    texture: str | None = None
    """Texture of all visual shapes, a name of :data:`orbit_scenes.document.build.TEXTURES`, or ``"none"``."""
    roughness: float | None = None
    """Roughness of all visual shapes, 0 to 1."""
    metallic: float | None = None
    """Share of a highlight that takes the surface's colour, 0 to 1."""
    joints: Mapping[str, JointChange] = field(default_factory=dict)
    """Changed joints, by name."""

    def __post_init__(self) -> None:
        check_name(self.name)
        given = [name for name in ("robot", "object", "file") if getattr(self, name)]
        if len(given) != 1:
            raise ConfigurationError(
                f"item '{self.name}' has {' and '.join(given) or 'no source'}: give one of robot, object and file"
            )
        if bool(self.file) != bool(self.entity):
            raise ConfigurationError(f"item '{self.name}' needs both, file and entity, or neither")

    @property
    def pose(self) -> Pose:
        """Pose of the root link."""
        return Pose(self.position, self.orientation)

    @property
    def source(self) -> str:
        """Source in words, for people."""
        chosen = next((str(value) for name, value in self.parameters.items() if name == self.object), "")
        return self.robot or (f"{self.file}: {self.entity}" if self.file else chosen or self.object)

    def at(self, pose: Pose) -> Item:
        """Return the item at another pose."""
        return replace(self, position=pose.position, orientation=pose.orientation)


@dataclass(frozen=True, kw_only=True)
class TaskPlan:
    """A task in a scene: bring objects of interest into a box.

    Raises:
        ConfigurationError: no object is named, or the goal has no size.
    """

    robot: str
    """Item that acts."""
    objects: tuple[str, ...]
    """Items that are to be in the goal region."""
    goal: Vector3
    """Middle of the goal region, m."""
    size: Vector3 = (0.2, 0.2, 0.2)
    """Full edge lengths of the goal region, m."""
    action: str = "joint_position"
    """Action space (``orbit list actions``)."""
    episode_length: float = 5.0
    """Seconds."""
    spread: float = 0.02
    """Metres along x and y by which the objects' starts vary either way."""
    instruction: str = ""
    """The task in words; empty names the objects."""

    def __post_init__(self) -> None:
        if not self.objects:
            raise ConfigurationError("the task has no object of interest: name one in its objects")
        if len(self.size) != 3 or not min(self.size) > 0.0:
            raise ConfigurationError(f"the task's goal region has size {self.size}: give three lengths above zero")


@dataclass(frozen=True, kw_only=True)
class SceneDocument:
    """A whole authored scene.

    Raises:
        ConfigurationError: two things have one name, there are too many, or the task names what is not there.
    """

    items: tuple[Item, ...] = ()
    """Robots and objects."""
    sensors: tuple[SensorSpec, ...] = ()
    """Sensors, cameras included."""
    ground: float | None = 0.0
    """Height of a ground plane, m; None: there is none."""
    terrain: str = ""
    """USD or MJCF file in the document's folder whose terrain stands in place of the ground plane."""
    ambient: Rgb = AmbientLight().color
    """Light from all around."""
    suns: tuple[DirectionalLight, ...] = (DirectionalLight(),)
    """Directional lights, three at most."""
    sky: Sky = field(default_factory=Sky)
    """Background of pictures."""
    gravity: Vector3 = (0.0, 0.0, -9.81)
    """m/s^2"""
    physics_dt: float = 0.005
    """Time step of the engine, s."""
    task: TaskPlan | None = None
    """Task in this scene; None: there is none."""

    def __post_init__(self) -> None:
        for what, things, most in (("item", self.items, MOST_ITEMS), ("sensor", self.sensors, MOST_SENSORS)):
            if len(things) > most:
                raise ConfigurationError(f"the scene has {len(things):,} {what}s, more than {most:,}: split it")
            seen: set[str] = set()
            for thing in things:
                if thing.name in seen:
                    raise ConfigurationError(f"two {what}s are called '{thing.name}': rename one")
                seen.add(thing.name)
        named = (self.task.robot, *self.task.objects) if self.task is not None else ()
        carriers = (getattr(sensor, "entity", None) for sensor in self.sensors)
        for name in (*named, *(carrier for carrier in carriers if carrier is not None)):
            self.item(name)

    def item(self, name: str) -> Item:
        """Return an item by name.

        Raises:
            UnknownNameError: there is none of that name.
        """
        for item in self.items:
            if item.name == name:
                return item
        raise UnknownNameError("item", name, [item.name for item in self.items], "the scene")

    def sensor(self, name: str) -> SensorSpec:
        """Return a sensor by name.

        Raises:
            UnknownNameError: there is none of that name.
        """
        for sensor in self.sensors:
            if sensor.name == name:
                return sensor
        raise UnknownNameError("sensor", name, [sensor.name for sensor in self.sensors], "the scene")


def check_name(name: str) -> None:
    """Reject what cannot be the name of an item or a sensor.

    Raises:
        ConfigurationError: it is longer than 64 characters, or has others than letters, digits and underscores.
    """
    if not _NAME.fullmatch(name):
        raise ConfigurationError(
            f"'{name[:80]}' is no name: take up to 64 letters, digits and underscores, the first one no digit"
        )
