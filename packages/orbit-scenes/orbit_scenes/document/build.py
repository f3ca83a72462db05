"""Scenes from documents: each item's entity is built from its source, then changed as the document says."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from orbit_assets.catalogue import robot
from orbit_assets.scene_files import load_scene
from orbit_core.configuration import field_types
from orbit_core.interfaces.errors import ConfigurationError, OrbitError, UnknownNameError
from orbit_core.interfaces.layout import home_positions
from orbit_core.interfaces.names import find_name, match_names
from orbit_core.objects import object_config, object_kinds
from orbit_core.plugin_kit.meshes import triangles
from orbit_core.preparation.merge import merge_fixed_links
from orbit_core.preparation.scene_data import check_data
from orbit_core.preparation.validation import link_poses, validate
from orbit_core.scene import (
    ActuatorConfig,
    AmbientLight,
    Articulation,
    Entity,
    Joint,
    Link,
    Mesh,
    ObjectSpec,
    Plane,
    Pose,
    RobotSpec,
    Scene,
    SensorSpec,
    Shape,
    Texture,
)
from orbit_core.scene.patterns import concrete, grid, wood
from orbit_core.scene.pose import FloatArray
from orbit_scenes.document.model import Item, JointChange, SceneDocument

TEXTURES = {"wood": wood, "concrete": concrete, "grid": grid}
"""Textures that an item's surfaces may take, by name."""
NO_TEXTURE = "none"
"""Word that takes a texture away."""
_GROUND = Scene().terrain[0]


class SceneBuilder:
    """Builder of scenes from documents; what was built once is kept.

    Args:
        folder: folder of the document's file, which all files that it names must be in.
    """

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._sources: dict[str, Entity] = {}
        self._entities: dict[str, Entity] = {}
        self._scenes: dict[str, Scene] = {}
        self._points: dict[str, FloatArray] = {}

    def scene(self, document: SceneDocument) -> Scene:
        """Build the scene of a document.

        Raises:
            OrbitError: of many kinds; each names the item, and the field where it knows it.
        """
        entities = [self.entity(item) for item in document.items]
        scene = Scene(
            robots=tuple(entity for entity in entities if isinstance(entity, RobotSpec)),
            objects=tuple(entity for entity in entities if isinstance(entity, ObjectSpec)),
            terrain=self._terrain(document),
            sensors=document.sensors,
            lights=(AmbientLight(document.ambient), *document.suns),
            sky=document.sky,
            gravity=document.gravity,
            physics_dt=document.physics_dt,
        )
        # Here and not only in a world: pictures and files are made of scenes that no engine ever sees. Entities were
        # checked when they were built, which takes a house's meshes most of a second.
        check_data(replace(scene, robots=(), objects=()), "scene")
        by_name = {entity.name: entity for entity in entities}
        for sensor in document.sensors:
            _check_frame(sensor, by_name)
        return scene

    def entity(self, item: Item) -> Entity:
        """Build an item's entity, with all changes and at its pose.

        Raises:
            OrbitError: of many kinds; names the item.
        """
        key = _key(item)
        check_data(item.pose, f"item '{item.name}'")
        if key not in self._entities:
            try:
                built = _changed(self.source(item), item)
                check_data(built, item.name)
                home_positions(built)  # rejects a home outside of the limits, which only a world would otherwise
            except OrbitError as error:
                prefix = f"item '{item.name}': "
                if isinstance(error, UnknownNameError) or str(error).startswith(prefix):
                    raise
                raise type(error)(f"{prefix}{error}") from error
            self._entities[key] = built
        return replace(self._entities[key], name=item.name, pose=item.pose)

    def source(self, item: Item) -> Entity:
        """Build what an item names, without its changes and at the source's own pose.

        Raises:
            OrbitError: of many kinds.
        """
        key = repr((item.robot, item.object, item.file, item.entity, sorted(item.parameters.items())))
        if key not in self._sources:
            spec = self._named(item)
            # Merged now: names of links and joints are then those that a world has, for joints and sensors to name.
            self._sources[key] = replace(spec, articulation=merge_fixed_links(validate(spec.articulation)))
        return self._sources[key]

    def file_scene(self, name: str) -> Scene:
        """Read the scene of a USD or MJCF file that a document names.

        Raises:
            AssetError: the file cannot be read as one.
            ConfigurationError: it is outside of the document's folder.
        """
        path = inside(self._folder, name)
        if name not in self._scenes:
            self._scenes[name] = load_scene(path)
        return self._scenes[name]

    def points(self, item: Item) -> FloatArray:
        """Return corners (P, 3) of an item's collision shapes in its root's frame, at its home position."""
        key = _key(item)
        if key not in self._points:
            self._points[key] = _points(self.entity(item))
        return self._points[key]

    def bounds(self, item: Item) -> tuple[FloatArray, FloatArray]:
        """Return the lowest and the highest corner (3,) of the box around an item in the scene, m."""
        points = item.pose.transform(self.points(item))
        return points.min(0), points.max(0)

    def _terrain(self, document: SceneDocument) -> tuple[Shape, ...]:
        if document.terrain:
            return self.file_scene(document.terrain).terrain
        if document.ground is None:
            return ()
        return (replace(_GROUND, pose=Pose((0.0, 0.0, document.ground))),)

    def _named(self, item: Item) -> Entity:
        if item.robot:
            if item.robot.endswith(".json"):  # a fitted robot is a file
                return robot(str(inside(self._folder, item.robot)))
            return robot(item.robot)
        if item.object:
            return object_config(item.object, **self._parameters(item)).build(item.name)
        scene = self.file_scene(item.file)
        names = [entity.name for entity in scene.entities]
        return scene.entities[find_name(item.entity, names, "entity", f"scene file {item.file}")]

    def _parameters(self, item: Item) -> dict[str, Any]:
        hints = field_types(object_kinds().get(item.object))
        # A parameter that names a file is held to the folder, as the files that the document itself names.
        return {
            name: inside(self._folder, value) if isinstance(value, str) and _takes_path(hints.get(name)) else value
            for name, value in item.parameters.items()
        }


def _check_frame(sensor: SensorSpec, entities: Mapping[str, Entity]) -> None:
    carrier, frame = getattr(sensor, "entity", None), getattr(sensor, "frame", None) or getattr(sensor, "link", None)
    if carrier is None or frame is None:
        return
    body = entities[carrier].articulation
    known = (*body.link_names, *(each.name for each in body.frames))
    if frame not in known:
        raise UnknownNameError("link or frame", frame, known, f"sensor '{sensor.name}' on '{carrier}'")


def inside(folder: Path, name: str) -> Path:
    """Return the path of a file in a folder or below it.

    Raises:
        ConfigurationError: the name leads out of the folder.
    """
    path = folder / name
    if "\0" in name or not path.resolve().is_relative_to(folder.resolve()):
        raise ConfigurationError(
            f"file '{name}' is outside of {folder}, the folder of the scene file: put it there, or save the scene as "
            "USD, which holds all of it"
        )
    return path


def _takes_path(hint: Any) -> bool:
    return hint is Path or Path in getattr(hint, "__args__", ())


def _key(item: Item) -> str:
    """Return a text that is the same for items that differ in name and pose only."""
    return repr(replace(item, name="item", position=(0.0, 0.0, 0.0), orientation=(1.0, 0.0, 0.0, 0.0)))


def _points(entity: Entity) -> FloatArray:
    body = entity.articulation
    poses = link_poses(body, dict(zip(body.joint_names, home_positions(entity), strict=True)))
    corners = [
        (poses[link.name] @ shape.pose).transform(
            shape.geometry.vertices if isinstance(shape.geometry, Mesh) else triangles(shape.geometry).vertices
        )
        for link in body.links
        for shape in link.collisions or link.visuals
        if not isinstance(shape.geometry, Plane)
    ]
    return np.concatenate(corners) if corners else np.zeros((1, 3))


# Changes -------------------------------------------------------------------------------------------------------------


def _changed(entity: Entity, item: Item) -> Entity:
    body = entity.articulation
    if item.mass is not None:
        body = _with_mass(body, item.mass)
    body = replace(body, links=tuple(_with_surfaces(link, item) for link in body.links))
    if item.fixed is not None:
        entity = replace(entity, fixed_base=item.fixed)
    entity = replace(entity, articulation=body)
    return _with_joints(entity, item.joints) if item.joints else entity


def _with_mass(body: Articulation, mass: float) -> Articulation:
    total = sum(link.mass for link in body.links)
    if not (mass > 0.0 and total > 0.0 and np.isfinite(mass)):
        raise ConfigurationError(f"its mass cannot be {mass} kg: give one above zero to what has a mass")
    share = mass / total
    links = tuple(replace(link, mass=share * link.mass, inertia=share * link.inertia) for link in body.links)
    return replace(body, links=links)


def _with_surfaces(link: Link, item: Item) -> Link:
    if item.friction is not None:
        collisions = tuple(
            replace(
                shape,
                material=replace(shape.material, static_friction=item.friction, dynamic_friction=item.friction),
            )
            for shape in link.collisions
        )
        link = replace(link, collisions=collisions)
    return replace(
        link,
        collisions=tuple(_dressed(shape, item) for shape in link.collisions),
        visuals=tuple(_dressed(shape, item) for shape in link.visuals),
    )


def _dressed(shape: Shape, item: Item) -> Shape:
    if item.color is not None:
        shape = replace(shape, color=(*item.color, shape.color[3]))
    looks: dict[str, Any] = {
        name: value for name in ("roughness", "metallic") if (value := getattr(item, name)) is not None
    }
    if item.texture is not None:
        looks["texture"] = _texture(item.texture)
    try:
        return replace(shape, finish=replace(shape.finish, **looks)) if looks else shape
    except ValueError as error:
        raise ConfigurationError(str(error)) from None


def _texture(name: str) -> Texture | None:
    if name == NO_TEXTURE:
        return None
    if name not in TEXTURES:
        raise UnknownNameError("texture", name, (*TEXTURES, NO_TEXTURE), "textures of items")
    return TEXTURES[name]()


def _with_joints(entity: Entity, changes: Mapping[str, JointChange]) -> Entity:
    body = entity.articulation
    home = dict(zip(body.joint_names, home_positions(entity).tolist(), strict=True))
    for name in changes:
        find_name(name, body.joint_names, "joint", f"item '{entity.name}'")
    joints = tuple(_limited(joint, changes.get(joint.name)) for joint in body.joints)
    for joint in joints:
        change = changes.get(joint.name)
        if change is not None and joint.mimic is None:
            wanted = home[joint.name] if change.home is None else change.home
            # A home that a new limit cuts off moves to the limit; one that was asked for is the world's to reject.
            within = min(max(wanted, joint.lower_limit), joint.upper_limit)
            home[joint.name] = within if change.home is None else wanted
    leaders = {re.escape(joint.name): home[joint.name] for joint in joints if joint.movable and joint.mimic is None}
    return replace(
        entity,
        articulation=replace(body, joints=joints),
        home=leaders,
        actuators=_with_drives(entity, changes),
    )


def _limited(joint: Joint, change: JointChange | None) -> Joint:
    if change is None:
        return joint
    lower = joint.lower_limit if change.lower is None else change.lower
    upper = joint.upper_limit if change.upper is None else change.upper
    if not lower <= upper:
        raise ConfigurationError(f"joint '{joint.name}' has limits from {lower} to {upper}: give the lower one first")
    return replace(joint, lower_limit=lower, upper_limit=upper)


def _with_drives(entity: Entity, changes: Mapping[str, JointChange]) -> tuple[ActuatorConfig, ...]:
    driven = {
        name: {"stiffness": change.stiffness, "damping": change.damping, "effort_limit": change.effort}
        for name, change in changes.items()
        if not all(gain is None for gain in (change.stiffness, change.damping, change.effort))
    }
    names = entity.articulation.joint_names
    where = f"an actuator group of '{entity.name}'"
    groups: list[ActuatorConfig] = []
    for group in entity.actuators:
        members = [names[index] for index in match_names(group.joints, names, "joint", where)]
        own = [name for name in members if name in driven]
        rest = [re.escape(name) for name in members if name not in driven]
        if not own:
            groups.append(group)
            continue
        if rest:
            groups.append(replace(group, joints=tuple(rest)))
        for name in own:
            given = {key: value for key, value in driven.pop(name).items() if value is not None}
            groups.append(replace(group, joints=(re.escape(name),), **given))
    if driven:
        raise ConfigurationError(f"joint '{next(iter(driven))}' has no drive, whose gains could be changed")
    return tuple(groups)
