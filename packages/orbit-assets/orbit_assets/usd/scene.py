"""Whole scenes in USD: articulations where they stand, what does not move, light and gravity."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from orbit_assets.inertia_repair import repaired
from orbit_assets.options import ReadOptions
from orbit_assets.placed import PlacedArticulation, SceneParts
from orbit_assets.usd.articulations import StageReader
from orbit_assets.usd.contents import STAGE
from orbit_assets.usd.library import pxr
from orbit_assets.usd.names import unique_names
from orbit_assets.usd.stage import Reading, attribute, authored, label, number, numbers, opened
from orbit_core.interfaces.errors import AssetError
from orbit_core.scene import AmbientLight, Articulation, DirectionalLight, Light, Scene, Shape
from orbit_core.scene.pose import Vector3
from orbit_core.scene.scene import MAX_DIRECTIONAL_LIGHTS, Rgb


def read_usd_scene(path: Path | str, *, options: ReadOptions = ReadOptions()) -> SceneParts:
    """All that a USD file holds, z up.

    Geometry outside every rigid body is one fixed articulation for each prim right below the default prim (or the
    stage) that holds any; planes among it are terrain. Distant lights are directional ones, of which the brightest is
    as bright as a scene's own, and dome lights are ambient; for other lights, as for none, a scene's own stand.

    Raises:
        AssetError: as :func:`orbit_assets.usd.read_usd`, but for several articulations.
    """
    with opened(path, options) as reading:
        stage = StageReader(reading)
        placed = stage.articulations() if stage.contents.bodies else []
        fixed, terrain = _static(stage)
        if not (placed or fixed or terrain):
            raise AssetError(f"{path} holds no rigid body and no geometry: add some")
        gravity, step = _physics(reading, stage.contents.scene)
        lights = _lights(reading, stage)
    every = tuple(replace(each, articulation=repaired(each.articulation, options)) for each in (*placed, *fixed))
    return SceneParts(every, terrain, lights, gravity, step, tuple(reading.notes))


def _static(stage: StageReader) -> tuple[list[PlacedArticulation], tuple[Shape, ...]]:
    """What does not move, by the prim that holds it, and the planes among it in the world's frame."""
    groups: dict[str, list[Any]] = {}
    planes: list[Shape] = []
    root = stage.reading.stage.GetPseudoRoot()
    for prim in stage.contents.parts.get(STAGE, []):
        if not prim.IsA(pxr().UsdGeom.Gprim):
            continue
        if prim.GetTypeName() == "Plane":
            planes += stage.links.static(root, [prim], "").collisions
        else:
            groups.setdefault(_holder(stage.reading.stage, prim), []).append(prim)
    names = unique_names({path: label(stage.reading.stage.GetPrimAtPath(path)) for path in groups})
    placed = []
    for path, prims in groups.items():
        holder = stage.reading.stage.GetPrimAtPath(path)
        link = stage.links.static(holder, prims, names[path])
        if link.collisions or link.visuals:
            static = Articulation(names[path], (link,))
            placed.append(PlacedArticulation(static, stage.placements.root(holder), True, path))
    return placed, tuple(planes)


def _holder(stage: Any, prim: Any) -> str:
    """The prim right below the default prim, or else below the stage, that holds ``prim``."""
    prefixes = prim.GetPath().GetPrefixes()
    top = stage.GetDefaultPrim()
    within = bool(top) and len(prefixes) > 1 and prefixes[0] == top.GetPath()
    return str(prefixes[1 if within else 0])


def _physics(reading: Reading, scene: Any) -> tuple[Vector3, float | None]:
    """Gravity in m/s^2, and the time step in s where the file gives one."""
    if scene is None:
        return Scene().gravity, None
    direction = np.asarray(numbers(scene, "physics:gravityDirection", (0.0, 0.0, 0.0)))
    magnitude = number(scene, "physics:gravityMagnitude", -math.inf)
    length = float(np.linalg.norm(direction))
    turned = reading.units.up.rotation_matrix() @ (direction / length) if length > 0 else np.array((0.0, 0.0, -1.0))
    # UsdPhysics: a negative magnitude stands for the earth's.
    size = magnitude * reading.units.length if magnitude >= 0 else -Scene().gravity[2]
    x, y, z = (float(value) for value in size * turned)
    rates = (authored(scene, name) for name in ("newton:timeStepsPerSecond", "physxScene:timeStepsPerSecond"))
    rate = next((value for value in rates if value), None)
    return (x, y, z), 1.0 / rate if rate and rate > 0 else None


def _lights(reading: Reading, stage: StageReader) -> tuple[Light, ...] | None:
    """The file's distant and dome lights; ``None`` where it has neither."""
    distant: list[tuple[float, DirectionalLight]] = []
    ambient: list[Light] = []
    for prim in stage.contents.lights:
        kind = prim.GetTypeName()
        power = number(prim, "inputs:intensity", 1.0) * 2.0 ** number(prim, "inputs:exposure", 0.0)
        color: Rgb = tuple(numbers(prim, "inputs:color", (1.0, 1.0, 1.0)))  # pyright: ignore[reportAssignmentType]
        if power <= 0 or pxr().UsdGeom.Imageable(prim).ComputeVisibility() == "invisible":
            continue
        if kind == "DistantLight":
            along = stage.placements.root(prim).rotation_matrix() @ reading.units.up.rotation_matrix()
            x, y, z = (float(value) for value in along @ np.array((0.0, 0.0, -1.0)))
            shadows = bool(attribute(prim, "inputs:shadow:enable", True))
            distant.append((power, DirectionalLight((x, y, z), color, shadows=shadows)))
        elif kind == "DomeLight":
            ambient.append(_dimmed(color))
        else:
            reading.note(f"the light {prim.GetPath()} is a {kind} and left out: scenes have distant and dome lights")
    distant.sort(key=lambda pair: -pair[0])
    if len(distant) > MAX_DIRECTIONAL_LIGHTS:
        reading.note(f"of {len(distant)} distant lights the brightest {MAX_DIRECTIONAL_LIGHTS} are kept")
    kept = distant[:MAX_DIRECTIONAL_LIGHTS]
    suns = [replace(light, intensity=light.intensity * power / kept[0][0]) for power, light in kept]
    return (*ambient, *suns) or None


def _dimmed(color: Rgb) -> AmbientLight:
    """A dome's light as bright as a scene's own ambient light, in the dome's colour."""
    red, green, blue = (own * part for own, part in zip(AmbientLight().color, color, strict=True))
    return AmbientLight((red, green, blue))
