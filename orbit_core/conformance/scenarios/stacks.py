"""Towers under a load that is much heavier than they are."""

from __future__ import annotations

from collections.abc import Mapping

import torch

from orbit_core.conformance.bodies import cube, scene
from orbit_core.conformance.contact import SMOOTH_GROUND, positions, smooth_material
from orbit_core.conformance.scenario import Metric, Scenario, Trial
from orbit_core.scene import Pose

_HALF, _COUNT, _APART = 0.05, 5, 1.0
_LOADS = (10.0, 100.0)
"""Loads in kg on towers of five cubes of 1 kg."""


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
)
