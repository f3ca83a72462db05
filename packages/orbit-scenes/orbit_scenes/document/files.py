"""Files of documents: TOML that a person can read and change, and scenes of USD and MJCF files as documents."""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Mapping
from enum import Enum
from pathlib import Path
from typing import Any

from orbit_assets.scene_files import load_scene
from orbit_assets.usd.scene_writer import write_usd_scene
from orbit_core.configuration import TypeChecker, from_plain, read_toml
from orbit_core.files import storage_faults, written_whole
from orbit_core.interfaces.errors import ArgumentError, ConfigurationError, UnknownNameError
from orbit_core.scene import (
    CameraSpec,
    ContactSensorSpec,
    EventCameraSpec,
    ForceTorqueSpec,
    FrameSensorSpec,
    ImuSpec,
    JointSensorSpec,
    RayCameraSpec,
    RayCasterSpec,
    SensorSpec,
    TactileSpec,
)
from orbit_scenes.document.build import SceneBuilder
from orbit_scenes.document.model import Item, SceneDocument

FORMAT = 1
"""Version of the file's form, its first line."""
SENSORS: dict[str, type[SensorSpec]] = {
    "camera": CameraSpec,
    "contact": ContactSensorSpec,
    "event_camera": EventCameraSpec,
    "force_torque": ForceTorqueSpec,
    "frame": FrameSensorSpec,
    "imu": ImuSpec,
    "joints": JointSensorSpec,
    "ray_camera": RayCameraSpec,
    "ray_caster": RayCasterSpec,
    "tactile": TactileSpec,
}
"""Specifications of sensors by their kind's name in a file."""
SUFFIX = ".toml"
"""End of the name of a document's file."""
SCENE_SUFFIXES = (".usd", ".usda", ".usdc", ".usdz", ".xml", ".mjcf")
"""Ends of the names of files that hold a whole scene."""
# Pixels along a side of a camera's picture that a file may name: a picture is drawn while the scene is edited.
_MOST_PIXELS = 4096


def load_document(path: Path) -> SceneDocument:
    """Read a document from its TOML file, or make one of the scene in a USD or MJCF file.

    Raises:
        ConfigurationError: the file cannot be read, is damaged, or has a value that its field does not take.
        UnknownNameError: it has a field, an item or a kind of sensor that is not known.
        AssetError: a USD or MJCF file holds no scene.
    """
    if path.suffix.lower() in SCENE_SUFFIXES:
        return imported(path)
    if path.suffix.lower() != SUFFIX:
        endings = ", ".join((SUFFIX, *SCENE_SUFFIXES))
        raise ConfigurationError(f"'{path}' is no scene file by its name: give one of {endings}")
    return document_of(read_toml(path, "scene file"), f"scene file {path}")


def document_of(values: Mapping[str, Any], where: str) -> SceneDocument:
    """Return the document that the tables of a TOML file describe.

    Args:
        values: tables of the file.
        where: name of the file in messages.

    Raises:
        ConfigurationError: as :func:`load_document`.
        UnknownNameError: as :func:`load_document`.
    """
    tables = dict(values)
    version = tables.pop("orbit_scene", None)
    if version != FORMAT:
        raise ConfigurationError(
            f"{where} begins with orbit_scene = {version!r}, not {FORMAT}: it is no scene, or one of another version"
        )
    if tables.pop("ground", 0.0) is False:  # TOML has no null
        ground: dict[str, Any] = {"ground": None}
    else:
        ground = {"ground": values["ground"]} if "ground" in values else {}
    sensors = tables.pop("sensors", [])
    if not isinstance(sensors, list):
        raise ConfigurationError(f"{where}.sensors is a {type(sensors).__name__}: write each as [[sensors]]")
    specs = tuple(_sensor(table, f"{where}.sensors[{index}]") for index, table in enumerate(sensors))
    document = from_plain(SceneDocument, {**tables, **ground}, where)
    document = dataclasses.replace(document, sensors=specs)
    # Reading has made tuples of any length: only here are vectors held to three numbers.
    TypeChecker().check(document, where)
    return document


def _sensor(table: Any, where: str) -> SensorSpec:
    if not isinstance(table, dict):
        raise ConfigurationError(f"{where} is no table")
    kind = table.get("kind")
    if kind not in SENSORS:
        raise UnknownNameError("kind of sensor", str(kind)[:80], SENSORS, where)
    spec = from_plain(SENSORS[kind], {name: value for name, value in table.items() if name != "kind"}, where)
    check_sensor(spec)
    return spec


def check_sensor(spec: SensorSpec) -> None:
    """Reject a camera whose pictures are too large to be drawn while a scene is edited.

    Raises:
        ArgumentError: a side has more than 4096 pixels.
    """
    if isinstance(spec, CameraSpec) and max(spec.width, spec.height) > _MOST_PIXELS:
        raise ArgumentError(
            f"camera '{spec.name}' has pictures of {spec.width} x {spec.height} pixels: give at most {_MOST_PIXELS} "
            "along a side"
        )


def imported(path: Path) -> SceneDocument:
    """Return a document of the scene in a USD or MJCF file; its items name the file's entities.

    Raises:
        AssetError: the file holds no scene.
        ConfigurationError: an entity's name is none for an item.
    """
    scene = load_scene(path)
    items = tuple(
        Item(
            name=entity.name,
            file=path.name,
            entity=entity.name,
            position=entity.pose.position,
            orientation=entity.pose.orientation,
        )
        for entity in scene.entities
    )
    return SceneDocument(
        items=items,
        ground=None,
        terrain=path.name if scene.terrain else "",
        ambient=scene.ambient,
        suns=scene.directional_lights,
        sky=scene.sky,
        gravity=scene.gravity,
        physics_dt=scene.physics_dt,
    )


def save_document(document: SceneDocument, path: Path) -> None:
    """Write a document to a TOML file, whole or not at all.

    Raises:
        StorageError: the file cannot be written.
    """
    text = document_text(document)
    with written_whole(path) as written, storage_faults(path):
        written.write_text(text, encoding="utf-8")


def save_usd(document: SceneDocument, builder: SceneBuilder, path: Path) -> tuple[str, ...]:
    """Write the scene of a document to a USD file; return what it cannot hold, a sentence each.

    Raises:
        AssetError: the file's name is of another format, or USD is not installed.
        StorageError: the file cannot be written.
    """
    lost = write_usd_scene(builder.scene(document), path)
    return (*lost, "the task is left out: TOML holds it") if document.task else lost


def document_text(document: SceneDocument) -> str:
    """Return a document as TOML; what is a default is left out."""
    tables = _plain(document)
    tables["sensors"] = [{"kind": _kind(spec), **_plain(spec)} for spec in document.sensors]
    if document.ground is None:
        tables["ground"] = False
    lines = [f"orbit_scene = {FORMAT}"]
    lines += [f"{name} = {_value(value)}" for name, value in tables.items() if not _is_table(value) and value != []]
    for name, value in tables.items():
        if isinstance(value, dict):
            lines += ["", f"[{name}]", *_assignments(value)]
        elif _is_table(value):
            for table in value:
                lines += ["", f"[[{name}]]", *_assignments(table)]
    return "\n".join(lines) + "\n"


def _kind(spec: SensorSpec) -> str:
    return next(kind for kind, known in SENSORS.items() if known is type(spec))


def _plain(thing: Any) -> dict[str, Any]:
    """Return the fields of a dataclass that differ from their defaults, as TOML's types."""
    table: dict[str, Any] = {}
    for each in dataclasses.fields(thing):
        value = getattr(thing, each.name)
        default = each.default if each.default_factory is dataclasses.MISSING else each.default_factory()
        if value is not None and value != default:
            table[each.name] = _toml(value)
    return table


def _toml(value: Any) -> Any:
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        return _plain(value)
    if isinstance(value, Enum):
        return value.value
    if isinstance(value, Mapping):
        return {str(key): _toml(part) for key, part in value.items()}
    if isinstance(value, tuple | list):
        return [_toml(part) for part in value]
    return str(value) if isinstance(value, Path) else value


def _is_table(value: Any) -> bool:
    return isinstance(value, dict) or (isinstance(value, list) and bool(value) and isinstance(value[0], dict))


def _assignments(table: Mapping[str, Any]) -> list[str]:
    return [f"{_key(name)} = {_value(value)}" for name, value in table.items()]


def _key(name: str) -> str:
    plain = name.replace("_", "").replace("-", "")
    return name if plain.isascii() and plain.isalnum() else _value(name)


def _value(value: Any) -> str:
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, str):
        # JSON's escapes are TOML's, but for the one character that only TOML must escape.
        return json.dumps(value, ensure_ascii=False).replace("\x7f", "\\u007f")
    if isinstance(value, dict):
        return "{" + ", ".join(_assignments(value)) + "}"
    if isinstance(value, list):
        return "[" + ", ".join(map(_value, value)) + "]"
    return repr(value)
