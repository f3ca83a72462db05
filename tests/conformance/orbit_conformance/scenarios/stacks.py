"""Towers under a load that is much heavier than they are, and towers on a slope."""

from __future__ import annotations

import math
from collections.abc import Mapping

import torch

from orbit_assets.objects import box
from orbit_conformance.bodies import SMOOTH, cube, on_slope, scene, slope
from orbit_conformance.contact import SMOOTH_GROUND, positions, smooth_material
from orbit_conformance.scenario import Metric, Scenario, Trial
from orbit_core.interfaces import Capability
from orbit_core.scene import Pose

_HALF, _COUNT, _APART = 0.05, 5, 1.0
# Loads in kg on towers of five cubes of 1 kg.
_LOADS = (10.0, 100.0)
# Blocks of a tower on a slope; metres of a block's height; tangent of the slope's angle.
_STOREYS, _STOREY, _TANGENT = 3, 0.1, 0.3
# Tangents of the slope over those at which towers, the wider the lower, should topple.
_STEEPNESS = (0.8, 0.9, 0.95, 0.98, 1.02, 1.05, 1.1, 1.2)


def _loaded_towers(trial: Trial) -> Mapping[str, float]:
    """Towers side by side; the sink of a layer is the overlap of a cube with the one below."""
    cubes = [
        cube(
            f"cube{layer}_{int(load)}",
            _HALF,
            load if layer == _COUNT else 1.0,
            Pose((_APART * tower, 0.0, _HALF + 2 * _HALF * layer)),
            smooth_material(0.5),
        )
        for tower, load in enumerate(_LOADS)
        for layer in range(_COUNT + 1)
    ]
    world = trial.world(scene(*cubes, terrain=SMOOTH_GROUND))
    curve, sinks, leans = [], [0.0] * len(_LOADS), [0.0] * len(_LOADS)
    start = positions(world)[0].cpu()
    for time in trial.advance(world, 8.0, every=0.1):
        places = positions(world)[0].cpu()
        for tower, (now, before) in enumerate(zip(places.chunk(len(_LOADS)), start.chunk(len(_LOADS)), strict=True)):
            heights = torch.cat((torch.tensor([-_HALF]), now[:, 2]))
            sinks[tower] = max(sinks[tower], float((2 * _HALF - heights.diff()).max()))
            leans[tower] = max(leans[tower], float((now - before)[:, :2].norm(dim=-1).max()))
        curve.append((time, float(places[-1, 2]), float(start[-1, 2])))
    trial.trace("height of the load of 100 kg", "m", *zip(*curve, strict=True))
    return {"sink_10": sinks[0], "sink_100": sinks[1], "lean_10": leans[0], "lean_100": leans[1]}


def _toppling(trial: Trial) -> Mapping[str, float]:
    """Towers side by side on one slope, each of another width ``b``: a tower topples where tan(angle) > b / (n h)."""
    angle, material = math.atan(_TANGENT), smooth_material(0.9)
    blocks = [
        box(
            f"block{layer}_{number}",
            (_STOREYS * _STOREY * _TANGENT / steepness, 0.1, _STOREY),
            mass=1.0,
            material=material,
            pose=on_slope(angle, 0.0) @ Pose((0.0, 0.3 * number, _STOREY * (layer + 0.5))),
        )
        for number, steepness in enumerate(_STEEPNESS)
        for layer in range(_STOREYS)
    ]
    world = trial.world(scene(*blocks, terrain=(slope(angle, SMOOTH),)))
    start = positions(world)[0].cpu()
    trial.step(world, trial.steps(2.0))
    moved = (positions(world)[0].cpu() - start).norm(dim=-1).view(len(_STEEPNESS), _STOREYS)
    fallen = moved[:, -1] > 0.5 * _STOREY
    steepness = torch.tensor(_STEEPNESS)
    wrong = (steepness - 1.0).abs()[fallen != (steepness > 1.0)]
    standing = moved[steepness < 0.9]
    return {"tilt": float(wrong.max()) if len(wrong) else 0.0, "creep": float(standing.max()) / 2.0}


SCENARIOS = (
    Scenario(
        name="loaded_tower",
        group="Rest",
        question="Does a tower of five cubes stand under a load of ten, and of a hundred, times a cube's mass?",
        truth="every cube stays where it is put for 8 s, 0.1 m above the one below",
        source="Goldstein, Classical Mechanics, 3rd ed., section 1.4 (equilibrium)",
        run=_loaded_towers,
        metrics=(
            Metric(name="sink_10", unit="m", tolerance=6e-5, meaning="greatest overlap of two layers, load of 10 kg"),
            Metric(name="sink_100", unit="m", tolerance=6e-4, meaning="the same under 100 kg"),
            Metric(
                name="lean_10",
                unit="m",
                tolerance=4e-4,
                meaning="longest way of a cube sideways, load of 10 kg",
                looser_because="four thousandths of a side; the best is at rounding error",
            ),
            Metric(
                name="lean_100",
                unit="m",
                tolerance=4e-3,
                meaning="the same under 100 kg",
                looser_because="a twenty-fifth of a side; the best is at rounding error",
            ),
        ),
    ),
    Scenario(
        name="toppling_tower",
        group="Rest",
        question="Does a tower of three blocks topple on a slope as steep as its width over its height, and no other?",
        truth="it topples where tan(angle) > b / (n h), the widths being such that this is 0.8 to 1.2 of the slope's",
        source="Meriam and Kraige, Statics, 7th ed., section 6/3 (impending tipping)",
        judges=(Capability.FRICTION,),
        run=_toppling,
        metrics=(
            Metric(
                name="tilt",
                unit="",
                tolerance=0.03,
                meaning="largest |tan(angle) n h / b - 1| at which a tower falls that should stand, or stands",
                looser_because="towers are told apart in steps of 2 %; the best engines tell all of them",
            ),
            Metric(
                name="creep",
                unit="m/s",
                tolerance=1e-4,
                meaning="largest mean speed of a block, in 2 s, of the tower that is a quarter wider than it need be",
                looser_because="a tenth of a millimetre in a second is rest for every purpose",
            ),
        ),
    ),
)
