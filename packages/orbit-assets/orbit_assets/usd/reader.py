"""Reader of USD files: articulations and whole scenes.

UsdPhysics describes them, and schemas of Newton, PhysX and MuJoCo add what it lacks. Beyond those schemas, a boolean
attribute ``orbit:frame = true`` on a transform below a rigid body makes it a named frame. Display names, where given,
name links, joints and frames, for USD's own names allow few characters; a name that several bodies share is lengthened
by those of the prims above. A collider is drawn too unless its purpose is "guide" or it is invisible.

Bodies that joints connect are one articulation. A stage may hold several, and static colliders: :func:`read_usd` reads
one articulation, :func:`read_usd_all` all.
"""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from orbit_assets.mass_properties import repaired
from orbit_assets.options import ReadOptions
from orbit_assets.placed import PlacedArticulation, SceneParts, chosen
from orbit_assets.usd.articulations import WORLD, StageReader
from orbit_assets.usd.contents import STAGE
from orbit_assets.usd.library import pxr, unique_names
from orbit_assets.usd.stage import Reading, attribute, authored, label, number, numbers, opened
from orbit_core.interfaces.errors import AssetError
from orbit_core.scene import AmbientLight, Articulation, DirectionalLight, Light, Scene, Shape
from orbit_core.scene.pose import Vector3
from orbit_core.scene.scene import MAX_DIRECTIONAL_LIGHTS, Rgb


def read_usd_scene(path: Path | str, *, options: ReadOptions = ReadOptions()) -> SceneParts:
    """Read all contents of a USD file, z up.

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
    """Return static geometry, grouped by the prim that holds it, and its planes in the world's frame."""
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
    """Return the prim right below the default prim, or else below the stage, that holds ``prim``."""
    prefixes = prim.GetPath().GetPrefixes()
    top = stage.GetDefaultPrim()
    within = bool(top) and len(prefixes) > 1 and prefixes[0] == top.GetPath()
    return str(prefixes[1 if within else 0])


def _physics(reading: Reading, scene: Any) -> tuple[Vector3, float | None]:
    """Return gravity in m/s^2, and the time step in s where the file gives one."""
    if scene is None:
        return Scene().gravity, None
    direction = np.asarray(numbers(scene, "physics:gravityDirection", (0.0, 0.0, 0.0)))
    magnitude = number(scene, "physics:gravityMagnitude", -math.inf)
    length = float(np.linalg.norm(direction))
    turned = reading.units.up.rotation_matrix() @ (direction / length) if length > 0 else np.array((0.0, 0.0, -1.0))
    # UsdPhysics: a negative magnitude means the earth's.
    size = magnitude * reading.units.length if magnitude >= 0 else -Scene().gravity[2]
    x, y, z = (float(value) for value in size * turned)
    rates = (authored(scene, name) for name in ("newton:timeStepsPerSecond", "physxScene:timeStepsPerSecond"))
    rate = next((value for value in rates if value), None)
    return (x, y, z), 1.0 / rate if rate and rate > 0 else None


def _lights(reading: Reading, stage: StageReader) -> tuple[Light, ...] | None:
    """Return the file's distant and dome lights; None where it has neither."""
    distant: list[tuple[float, DirectionalLight]] = []
    ambient: list[Light] = []
    for prim in stage.contents.lights:
        kind = prim.GetTypeName()
        # Exposure is in stops: powers of two.
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
    # USD's intensities are in units of luminance: only their ratios are kept.
    suns = [replace(light, intensity=light.intensity * power / kept[0][0]) for power, light in kept]
    return (*ambient, *suns) or None


def _dimmed(color: Rgb) -> AmbientLight:
    """Return an ambient light as bright as a scene's own, in the dome's colour."""
    red, green, blue = (own * part for own, part in zip(AmbientLight().color, color, strict=True))
    return AmbientLight((red, green, blue))


def read_usd(path: Path | str, *, options: ReadOptions = ReadOptions()) -> Articulation:
    """Read one articulation of a USD file: the only one, or the one that ``options.articulation`` names.

    Where the root stands in the stage is left out, as is a fixed joint that holds it there: the entity says both. A
    stage with colliders and no rigid body is one static link.

    Raises:
        AssetError: the file cannot be opened or is not whole, holds several articulations and none is named, or
            something that the description lacks, or USD is not installed.
    """
    with opened(path, options) as reading:
        stage = StageReader(reading)
        placed = chosen(stage.articulations(), options.articulation)
        strays = stage.contents.static_colliders if stage.contents.bodies else []
        if strays:
            told = ", ".join(str(prim.GetPath()) for prim in strays[:5])
            more = f" and {len(strays) - 5} more" if len(strays) > 5 else ""
            reading.note(f"colliders outside every rigid body are left out: {told}{more}")
        if placed.fixed_base and stage.contents.bodies and placed.articulation.root.name != WORLD:
            reading.note("the fixed joint to the world is left out: the entity says whether its base is fixed")
    return repaired(_noted(placed, reading.notes).articulation, options)


def read_usd_all(path: Path | str, *, options: ReadOptions = ReadOptions()) -> tuple[PlacedArticulation, ...]:
    """Read all articulations of a USD file, in the stage's order, each at its pose in the stage.

    Notes on the stage as a whole are in those of the first.

    Raises:
        AssetError: as :func:`read_usd`, but for several.
    """
    with opened(path, options) as reading:
        first, *others = StageReader(reading).articulations()
    every = (_noted(first, reading.notes), *others)
    return tuple(replace(placed, articulation=repaired(placed.articulation, options)) for placed in every)


def _noted(placed: PlacedArticulation, notes: list[str]) -> PlacedArticulation:
    articulation = placed.articulation
    told = tuple(dict.fromkeys((*notes, *articulation.notes)))
    return replace(placed, articulation=replace(articulation, notes=told))
