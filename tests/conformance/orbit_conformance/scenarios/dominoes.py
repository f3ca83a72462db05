"""A row of dominoes."""

from __future__ import annotations

import math
from collections.abc import Mapping

import torch

from orbit_assets.objects import box
from orbit_conformance.bodies import scene
from orbit_conformance.contact import SMOOTH_GROUND, smooth_material
from orbit_conformance.scenario import Metric, Scenario, Trial
from orbit_core.dynamics.transforms import quat_rotate
from orbit_core.scene import Pose

_COUNT = 8
# Thickness, width and height in metres.
_SIZE = (0.03, 0.1, 0.2)
# Distance in metres from middle to middle.
_APART = 0.1
# Angular velocity in rad/s of the first domino about its lower edge.
_PUSH = 3.0
_TILTED = math.radians(10.0)
# Speed in m/s from the fourth piece to the last: three engines at steps of 0.25 ms come to 1.268, 1.274 and 1.276.
_SPEED = 1.275


def _dominoes(trial: Trial) -> Mapping[str, float]:
    pieces = [
        box(f"piece{number}", _SIZE, mass=0.5, material=smooth_material(0.5), pose=Pose((_APART * number, 0.0, 0.1)))
        for number in range(_COUNT)
    ]
    world = trial.world(scene(*pieces, terrain=SMOOTH_GROUND))
    trial.step(world, trial.steps(0.1))
    # About the edge at (thickness / 2, -height / 2) from the middle.
    speed = [_PUSH * _SIZE[2] / 2, 0.0, _PUSH * _SIZE[0] / 2, 0.0, _PUSH, 0.0]
    world.objects["piece0"].set_root_velocity(torch.tensor([speed], device=world.device))
    tipped = torch.full((_COUNT,), math.nan, dtype=torch.float64)
    before = torch.zeros(_COUNT, dtype=torch.float64)
    up = torch.tensor([0.0, 0.0, 1.0], dtype=torch.float64).expand(_COUNT, 3)
    for time in trial.advance(world, 0.9):
        poses = torch.cat([thing.root_pose for thing in world.objects.values()]).double().cpu()
        top = quat_rotate(poses[:, 3:], up)
        tilt = torch.atan2(top[:, 0], top[:, 2])
        passed = (before < _TILTED) & (tilt >= _TILTED) & tipped.isnan()
        at = time - trial.time_step * (tilt - _TILTED) / (tilt - before)
        tipped = torch.where(passed, at, tipped)
        before = tilt
    numbers = list(range(_COUNT))
    steady = [float(tipped[3]) + (number - 3) * _APART / _SPEED for number in numbers]
    trial.trace("time at which a piece tips, over its number", "s", numbers, tipped.tolist(), steady)
    stages = tipped.diff()
    return {
        "standing": float((~(stages > 0)).sum()),
        "speed": abs(float((_COUNT - 4) * _APART / (tipped[-1] - tipped[3])) / _SPEED - 1),
    }


SCENARIOS = (
    Scenario(
        name="dominoes",
        group="Impact",
        question="Does a row of dominoes fall, one after the other, as fast at any time step?",
        truth="a wave of 1.275 m/s, to which three engines with nothing in common converge within 0.6 % at 0.25 ms",
        source="convergence; van Leeuwen, American Journal of Physics 78, 2010, p. 721 (a wave of constant speed)",
        run=_dominoes,
        metrics=(
            Metric(name="standing", unit="", tolerance=0.0, meaning="pieces that did not tip after the one before"),
            Metric(
                name="speed",
                unit="",
                tolerance=0.02,
                meaning="relative error of the wave's speed between the fourth piece and the last",
                looser_because="the reference is known to half a per cent",
            ),
        ),
    ),
)
