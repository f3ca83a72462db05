"""Whether a scene's data is what its dataclasses say, down to the last number, before anything is made of it."""

from __future__ import annotations

import dataclasses
import functools
import math
import numbers
import types
import typing
from collections.abc import Callable, Mapping, Sequence
from enum import Enum
from typing import Any

import numpy as np

from orbit_core.interfaces.divergence import MAX_DISTANCE, MAX_SPEED
from orbit_core.interfaces.errors import AssetError
from orbit_core.scene import Box, CameraSpec, Capsule, Cylinder, PhysicsMaterial, Pose, Scene, Sphere

_UNIT = 1e-3
"""By how much a quaternion's length may differ from 1; written ones have few digits."""


def check_data(thing: object, where: str) -> None:
    """Hold a dataclass of a scene to its fields' types, and its numbers to what they may be.

    Args:
        thing: a scene, or a part of one.
        where: its name, for the message.

    Raises:
        AssetError: names the field, by its path from ``where``, its value and what is wanted.
    """
    for name, hint in _hints(type(thing)).items():
        _check(getattr(thing, name), hint, f"{where}.{name}")
    rule = _RULES.get(type(thing))
    if rule is not None:
        rule(thing, where)


@functools.cache
def _hints(kind: type) -> dict[str, Any]:
    hints = typing.get_type_hints(kind)
    return {field.name: hints[field.name] for field in dataclasses.fields(kind)}


def _check(value: Any, hint: Any, where: str) -> None:
    origin = typing.get_origin(hint)
    if origin in (typing.Union, types.UnionType):
        _check_union(value, typing.get_args(hint), where)
    elif origin is tuple:
        _check_tuple(value, typing.get_args(hint), where)
    elif origin is not None and isinstance(origin, type) and issubclass(origin, Mapping):
        _check_mapping(value, typing.get_args(hint), where)
    elif origin is np.ndarray:
        _check_array(value, where)
    elif isinstance(hint, type):
        _check_plain(value, hint, where)


def _check_union(value: Any, branches: Sequence[Any], where: str) -> None:
    if value is None and type(None) in branches:
        return None
    kinds = [branch for branch in branches if isinstance(branch, type) and dataclasses.is_dataclass(branch)]
    for branch in kinds:
        if isinstance(value, branch):
            return _check(value, branch, where)
    others = [branch for branch in branches if branch not in kinds and branch is not type(None)]
    if not others:
        raise _error(where, value, " or ".join(kind.__name__ for kind in kinds))
    return _check(value, others[0], where)


def _check_tuple(value: Any, parts: Sequence[Any], where: str) -> None:
    if not isinstance(value, Sequence | np.ndarray) or isinstance(value, str | bytes):
        raise _error(where, value, "a tuple")
    repeated = len(parts) == 2 and parts[1] is Ellipsis
    if not repeated and len(value) != len(parts):
        raise _error(where, value, f"{len(parts)} of them")
    for index, part in enumerate(value):
        _check(part, parts[0] if repeated else parts[index], f"{where}[{index}]")


def _check_mapping(value: Any, parts: Sequence[Any], where: str) -> None:
    if not isinstance(value, Mapping):
        raise _error(where, value, "a dictionary")
    for key, part in value.items():
        _check(key, parts[0], f"a key of {where}")
        _check(part, parts[1], f"{where}[{key!r}]")


def _check_array(value: Any, where: str) -> None:
    if not isinstance(value, np.ndarray) or not np.issubdtype(value.dtype, np.number):
        raise _error(where, value, "an array of numbers")
    if np.isnan(value).any():
        raise AssetError(f"{where} holds NaN: give numbers")


def _check_plain(value: Any, hint: type, where: str) -> None:
    if hint is float or hint is int:
        wanted = numbers.Real if hint is float else numbers.Integral
        if isinstance(value, bool | np.bool_) or not isinstance(value, wanted) or math.isnan(value):
            raise _error(where, value, "a number" if hint is float else "a whole number")
    elif hint is bool:
        if not isinstance(value, bool | np.bool_):
            raise _error(where, value, "true or false")
    elif (hint is str or issubclass(hint, Enum) or dataclasses.is_dataclass(hint)) and not isinstance(value, hint):
        raise _error(where, value, f"a {hint.__name__}")
    elif dataclasses.is_dataclass(value):
        check_data(value, where)


def _within(where: str, values: Sequence[float], least: float, most: float, unit: str = "") -> None:
    for value in values:
        if not least <= value <= most:
            raise _error(where, value, f"{least:g} to {most:g} {unit}".rstrip())


def _check_pose(pose: Pose, where: str) -> None:
    _within(f"{where}.position", pose.position, -MAX_DISTANCE, MAX_DISTANCE, "m")
    if not abs(math.hypot(*pose.orientation) - 1.0) < _UNIT:
        raise _error(f"{where}.orientation", pose.orientation, "a quaternion (w, x, y, z) of length 1")


def _check_material(material: PhysicsMaterial, where: str) -> None:
    for field in dataclasses.fields(material):
        value = getattr(material, field.name)
        if field.name != "compliance":
            _within(f"{where}.{field.name}", (value,), 0.0, 1.0 if field.name == "restitution" else 1e6)


def _check_size(solid: Box | Sphere | Capsule | Cylinder, where: str) -> None:
    lengths = solid.half_extents if isinstance(solid, Box) else (solid.radius,)
    _within(f"{where}.{'half_extents' if isinstance(solid, Box) else 'radius'}", lengths, 1e-9, MAX_DISTANCE, "m")
    if isinstance(solid, Capsule | Cylinder):
        _within(f"{where}.half_length", (solid.half_length,), 0.0, MAX_DISTANCE, "m")


def _check_camera(camera: CameraSpec, where: str) -> None:
    _within(f"{where}.width", (camera.width,), 1, 2**15, "pixels")
    _within(f"{where}.height", (camera.height,), 1, 2**15, "pixels")
    _within(f"{where}.vertical_fov", (camera.vertical_fov,), 1e-3, math.pi - 1e-3, "rad")
    if not 0.0 < camera.near < camera.far:
        raise AssetError(f"{where} sees from near {camera.near} to far {camera.far} m: give 0 < near < far")


def _check_scene(scene: Scene, where: str) -> None:
    _within(f"{where}.gravity", scene.gravity, -MAX_SPEED, MAX_SPEED, "m/s^2")
    _within(f"{where}.physics_dt", (scene.physics_dt,), 1e-7, 1.0, "s")


_RULES: Mapping[type, Callable[[Any, str], None]] = {
    Pose: _check_pose,
    PhysicsMaterial: _check_material,
    Box: _check_size,
    Sphere: _check_size,
    Capsule: _check_size,
    Cylinder: _check_size,
    CameraSpec: _check_camera,
    Scene: _check_scene,
}


def _error(where: str, value: object, wanted: str) -> AssetError:
    shown = repr(value)
    return AssetError(f"{where} is {shown if len(shown) < 80 else type(value).__name__}: give {wanted}")
