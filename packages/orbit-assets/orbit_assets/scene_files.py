"""Whole scenes of USD and MJCF files: every robot, object and static shape, placed as in the file, with its drives."""

from __future__ import annotations

import math
import re
from dataclasses import replace
from pathlib import Path
from typing import Any

from orbit_assets.options import ReadOptions
from orbit_assets.placed import PlacedArticulation, SceneParts
from orbit_assets.source_text import names_file
from orbit_assets.usd.library import unique_names
from orbit_core.interfaces.errors import AssetError, ConfigurationError
from orbit_core.preparation.merge import merge_fixed_links
from orbit_core.preparation.validation import validate
from orbit_core.scene import (
    Articulation,
    DriveGains,
    Entity,
    HeightField,
    ImplicitPd,
    ObjectSpec,
    Plane,
    RobotSpec,
    Scene,
    Shape,
)


def drives_from_model(articulation: Articulation) -> tuple[ImplicitPd, ...]:
    """Actuator groups with the gains and effort limits of the articulation's ``drives``, for ``RobotSpec.actuators``.

    Joints of one gain share a group. A drive without an effort limit keeps the joint's own.

    Raises:
        ConfigurationError: the file says of no drive.
    """
    if not articulation.drives:
        raise ConfigurationError(f"the file of '{articulation.name}' says of no drive: give actuator groups yourself")
    groups: dict[DriveGains, list[str]] = {}
    for drive in articulation.drives:
        groups.setdefault(replace(drive, joint=""), []).append(drive.joint)
    return tuple(
        ImplicitPd(
            joints=tuple(re.escape(joint) for joint in joints),
            stiffness=gains.stiffness,
            damping=gains.damping,
            effort_limit=gains.effort_limit if math.isfinite(gains.effort_limit) else None,
        )
        for gains, joints in groups.items()
    )


def home_from_model(articulation: Articulation) -> dict[str, float]:
    """Return the articulation's ``home``, for ``RobotSpec.home``.

    Raises:
        ConfigurationError: the file says of no home pose.
    """
    if not articulation.home:
        raise ConfigurationError(f"the file of '{articulation.name}' names no home pose: give home positions yourself")
    return {re.escape(joint): position for joint, position in articulation.home}


_USD = (".usd", ".usda", ".usdc", ".usdz")
_MJCF = (".xml", ".mjcf")


@names_file
def load_scene(path: Path | str, *, options: ReadOptions = ReadOptions()) -> Scene:
    """Read the scene that a USD or MJCF file describes.

    What the file drives is a robot: its drives' gains become its actuators, and the positions that the file gives its
    joints its home. Everything else is an object, fixed where the file fixes it. Planes and height fields that do not
    move are terrain. What the file does not say is a scene's default; an MJCF file's light, gravity and time step are
    not read. Notes on the file as a whole stand with those of the first articulation.

    Raises:
        AssetError: the file is of another format, cannot be read, or describes what cannot be simulated.
    """
    parts = _read(Path(path), options)
    entities: list[Entity] = []
    terrain = list(parts.terrain)
    names = unique_names({str(index): each.articulation.name for index, each in enumerate(parts.placed)})
    for placed, name in zip(parts.placed, names.values(), strict=True):
        rest = _without_ground(placed, terrain)
        if rest is not None:
            entities.append(_entity(rest, name))
    if entities and parts.notes:
        first = entities[0].articulation
        # A scene has no notes: those of the file go to the first articulation.
        noted = replace(first, notes=tuple(dict.fromkeys((*parts.notes, *first.notes))))
        entities[0] = replace(entities[0], articulation=noted)
    said: dict[str, Any] = {"lights": parts.lights, "gravity": parts.gravity, "physics_dt": parts.physics_dt}
    return Scene(
        robots=tuple(entity for entity in entities if isinstance(entity, RobotSpec)),
        objects=tuple(entity for entity in entities if isinstance(entity, ObjectSpec)),
        terrain=tuple(terrain),
        **{name: value for name, value in said.items() if value is not None},
    )


def _read(path: Path, options: ReadOptions) -> SceneParts:
    suffix = path.suffix.lower()
    if suffix in _USD:
        from orbit_assets.usd.reader import read_usd_scene

        return read_usd_scene(path, options=options)
    if suffix in _MJCF:
        from orbit_assets.mjcf import read_mjcf_all

        return SceneParts(read_mjcf_all(path, options=options))
    raise AssetError(f"'{path}' holds no scene: give a file of one of {', '.join((*_USD, *_MJCF))}")


def _without_ground(placed: PlacedArticulation, terrain: list[Shape]) -> PlacedArticulation | None:
    """Move the ground of a static link to ``terrain``; return the rest, or None if nothing is left."""
    articulation = placed.articulation
    if not placed.fixed_base or len(articulation.links) > 1:
        return placed
    link = articulation.root
    ground = [shape for shape in link.collisions if _is_ground(shape)]
    terrain += [replace(shape, pose=placed.pose @ shape.pose) for shape in ground]
    kept = replace(
        link,
        collisions=tuple(shape for shape in link.collisions if not _is_ground(shape)),
        visuals=tuple(shape for shape in link.visuals if not _is_ground(shape)),
    )
    if ground and not (kept.collisions or kept.visuals):
        return None
    return replace(placed, articulation=replace(articulation, links=(kept,)))


def _is_ground(shape: Shape) -> bool:
    return isinstance(shape.geometry, Plane | HeightField)


def _entity(placed: PlacedArticulation, name: str) -> Entity:
    articulation = merge_fixed_links(validate(placed.articulation))
    common: dict[str, Any] = {
        "name": name,
        "articulation": articulation,
        "pose": placed.pose,
        "fixed_base": placed.fixed_base,
        "home": home_from_model(articulation) if articulation.home else {},
    }
    # Drives make a robot: an object has no actuators.
    if articulation.drives:
        return RobotSpec(actuators=drives_from_model(articulation), **common)
    return ObjectSpec(**common)
