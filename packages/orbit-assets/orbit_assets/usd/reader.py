"""Reads articulations from USD: UsdPhysics, and what it lacks from Newton's, PhysX' and MuJoCo's schemas.

Beyond those schemas, a boolean attribute ``orbit:frame = true`` on a transform below a rigid body makes it a named
frame. Display names, where given, name links, joints and frames, for USD's own names allow few characters; a name that
several bodies share is lengthened by those of the prims above. A collider is drawn too unless its purpose is "guide" or
it is invisible.

Bodies that joints connect are one articulation. A stage may hold several, and colliders that do not move beside them:
:func:`read_usd` reads one of them, :func:`read_usd_all` all.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from orbit_assets.inertia_repair import repaired
from orbit_assets.options import ReadOptions
from orbit_assets.placed import PlacedArticulation, chosen
from orbit_assets.usd.articulations import WORLD, StageReader
from orbit_assets.usd.stage import opened
from orbit_core.scene import Articulation


def read_usd(path: Path | str, *, options: ReadOptions = ReadOptions()) -> Articulation:
    """One articulation of a USD file: the only one, or that which ``options.articulation`` names.

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
    """All articulations of a USD file that rigid bodies make, in the stage's order, each where the stage puts it.

    What is to be told of the stage as a whole is in the notes of the first.

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
