"""Whether a scene's data is what its dataclasses say, and its numbers can be, before anything is made of it."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence

import numpy as np

from orbit_core.interfaces.divergence import MAX_DISTANCE, MAX_SPEED
from orbit_core.interfaces.errors import ArgumentError
from orbit_core.interfaces.typed import Typed, wrong
from orbit_core.preparation.deformable_checks import check_deformable
from orbit_core.preparation.surface_checks import check_height_field, check_hulls, check_mesh
from orbit_core.scene import (
    AmbientLight,
    Box,
    CameraSpec,
    Capsule,
    Cloth,
    Compliance,
    Cylinder,
    DirectionalLight,
    Fluid,
    HeightField,
    Joint,
    Link,
    Mesh,
    PhysicsMaterial,
    Pose,
    Region,
    Rope,
    Scene,
    Shape,
    Sky,
    SoftBody,
    Sphere,
)
from orbit_core.scene.lights import MAX_DIRECTIONAL_LIGHTS

_UNIT = 1e-3
"""Largest difference of a quaternion's length from 1; written ones have few digits."""

_BRIGHTEST = 1e3
"""Largest brightness of a light, in pictures' full brightness."""
_HEAVIEST = 1e9
"""Kilograms of a link; beyond, single precision holds little of what it touches."""

_LARGEST_INERTIA = 1e15
"""kg m^2; single precision holds its square."""
_STIFFEST = 1e12
"""N/m of a contact or a joint's spring, and the most of a joint's damping, friction and armature in their units."""

_COEFFICIENTS = tuple(field.name for field in dataclasses.fields(PhysicsMaterial) if field.name != "compliance")


def check_data(thing: object, where: str) -> None:
    """Hold a dataclass of a scene to its fields' types, and its numbers to what they may be.

    Args:
        thing: a scene, or a part of one.
        where: its name, for the message.

    Raises:
        ArgumentError: names the field, by its path from ``where``, its value and what is wanted.
    """
    _SCENES.check(thing, where)


def _within(where: str, values: Sequence[float], least: float, most: float, unit: str = "") -> None:
    for value in values:
        if not least <= value <= most:
            raise wrong(where, value, f"{least:g} to {most:g} {unit}".rstrip())


def _check_pose(pose: Pose, where: str) -> None:
    _within(f"{where}.position", pose.position, -MAX_DISTANCE, MAX_DISTANCE, "m")
    if not abs(math.hypot(*pose.orientation) - 1.0) < _UNIT:
        raise wrong(f"{where}.orientation", pose.orientation, "a quaternion (w, x, y, z) of length 1")


def _check_material(material: PhysicsMaterial, where: str) -> None:
    for name in _COEFFICIENTS:
        _within(f"{where}.{name}", (getattr(material, name),), 0.0, 1.0 if name == "restitution" else 1e6)


def _check_size(solid: Box | Sphere | Capsule | Cylinder, where: str) -> None:
    lengths = solid.half_extents if isinstance(solid, Box) else (solid.radius,)
    _within(f"{where}.{'half_extents' if isinstance(solid, Box) else 'radius'}", lengths, 1e-9, MAX_DISTANCE, "m")
    if isinstance(solid, Capsule | Cylinder):
        shortest = 1e-9 if isinstance(solid, Cylinder) else 0.0
        _within(f"{where}.half_length", (solid.half_length,), shortest, MAX_DISTANCE, "m")


def _check_region(region: Region, where: str) -> None:
    _within(f"{where}.half_extents", region.half_extents, 1e-9, MAX_DISTANCE, "m")


def _check_compliance(compliance: Compliance, where: str) -> None:
    _within(f"{where}.stiffness", (compliance.stiffness,), 1e-9, _STIFFEST, "N/m")
    _within(f"{where}.damping", (compliance.damping,), 0.0, _STIFFEST, "N s/m")


def _check_shape(shape: Shape, where: str) -> None:
    _within(f"{where}.color", shape.color, 0.0, 1.0)


def _check_joint(joint: Joint, where: str) -> None:
    _within(f"{where}.axis", joint.axis, -_STIFFEST, _STIFFEST)
    _within(f"{where}.rest_position", (joint.rest_position,), -MAX_DISTANCE, MAX_DISTANCE)
    for name in ("damping", "friction", "armature", "stiffness"):
        _within(f"{where}.{name}", (getattr(joint, name),), 0.0, _STIFFEST)
    for name in ("effort_limit", "velocity_limit"):
        _within(f"{where}.{name}", (getattr(joint, name),), 0.0, math.inf)
    if joint.lower_limit == math.inf or joint.upper_limit == -math.inf:
        raise wrong(f"{where}'s limits", (joint.lower_limit, joint.upper_limit), "the lowest position and the highest")


def _check_camera(camera: CameraSpec, where: str) -> None:
    _within(f"{where}.width", (camera.width,), 1, 2**15, "pixels")
    _within(f"{where}.height", (camera.height,), 1, 2**15, "pixels")
    _within(f"{where}.vertical_fov", (camera.vertical_fov,), 1e-3, math.pi - 1e-3, "rad")
    if not 0.0 < camera.near < camera.far:
        raise ArgumentError(f"{where} sees from near {camera.near} to far {camera.far} m: give 0 < near < far")


def _check_link(link: Link, where: str) -> None:
    _within(f"{where}.mass", (link.mass,), 0.0, _HEAVIEST, "kg")
    _within(f"{where}.center_of_mass", link.center_of_mass, -MAX_DISTANCE, MAX_DISTANCE, "m")
    if np.shape(link.inertia) != (3, 3):
        raise ArgumentError(f"{where}.inertia has shape {np.shape(link.inertia)}: give (3, 3)")
    _within(f"{where}.inertia", link.inertia.ravel().tolist(), -_LARGEST_INERTIA, _LARGEST_INERTIA, "kg m^2")
    check_hulls(link.collisions, f"{where}.collisions")


def _check_ambient_light(light: AmbientLight, where: str) -> None:
    _within(f"{where}.color", light.color, 0.0, _BRIGHTEST)


def _check_directional_light(light: DirectionalLight, where: str) -> None:
    _within(f"{where}.direction", light.direction, -_BRIGHTEST, _BRIGHTEST)
    if math.hypot(*light.direction) < _UNIT:
        raise wrong(f"{where}.direction", light.direction, "where the light travels to, a vector that is not zero")
    _within(f"{where}.color", light.color, 0.0, _BRIGHTEST)
    _within(f"{where}.intensity", (light.intensity,), 0.0, _BRIGHTEST)


def _check_sky(sky: Sky, where: str) -> None:
    _within(f"{where}.above", sky.above, 0.0, 1.0)
    _within(f"{where}.below", sky.below, 0.0, 1.0)


def _check_scene(scene: Scene, where: str) -> None:
    check_hulls(scene.terrain, f"{where}.terrain")
    _within(f"{where}.gravity", scene.gravity, -MAX_SPEED, MAX_SPEED, "m/s^2")
    _within(f"{where}.physics_dt", (scene.physics_dt,), 1e-7, 1.0, "s")
    count = len(scene.directional_lights)
    if count > MAX_DIRECTIONAL_LIGHTS:
        raise ArgumentError(f"{where}.lights has {count} directional lights: give {MAX_DIRECTIONAL_LIGHTS} at most")


_SCENES = Typed(
    {
        Pose: _check_pose,
        PhysicsMaterial: _check_material,
        Box: _check_size,
        Sphere: _check_size,
        Capsule: _check_size,
        Cylinder: _check_size,
        Mesh: check_mesh,
        HeightField: check_height_field,
        Shape: _check_shape,
        Compliance: _check_compliance,
        Joint: _check_joint,
        CameraSpec: _check_camera,
        Link: _check_link,
        AmbientLight: _check_ambient_light,
        DirectionalLight: _check_directional_light,
        Sky: _check_sky,
        Cloth: check_deformable,
        Rope: check_deformable,
        SoftBody: check_deformable,
        Fluid: check_deformable,
        Region: _check_region,
        Scene: _check_scene,
    }
)
