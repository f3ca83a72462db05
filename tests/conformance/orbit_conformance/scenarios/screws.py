"""A nut that runs down a smooth bolt by its weight."""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np

from orbit_assets.threads import Thread, bolt_boxes, nut_boxes
from orbit_conformance.bodies import SMOOTH, G, scene
from orbit_conformance.scenario import Metric, Scenario, Trial
from orbit_core.dynamics.transforms import yaw_angle
from orbit_core.scene import Articulation, Link, ObjectSpec, Pose

_THREAD = Thread(radius=0.03, lead=0.008)
_LENGTH, _HEIGHT, _CLEARANCE = 0.05, 0.02, 2e-4
_MASS, _INERTIA = 1.0, 1e-3


def _screw(trial: Trial) -> Mapping[str, float]:
    """Threads of boxes, which every engine has as they are; all of the nut is on the bolt from the start."""
    rod = bolt_boxes(_LENGTH, _THREAD, SMOOTH)
    ring = nut_boxes(_HEIGHT, _THREAD.radius + 0.01, _THREAD, SMOOTH, clearance=_CLEARANCE)
    fixed = Link("bolt", 1.0, (0.0, 0.0, 0.0), np.eye(3), rod, rod)
    moving = Link("nut", _MASS, (0.0, 0.0, 0.5 * _HEIGHT), _INERTIA * np.eye(3), ring, ring)
    bolt = ObjectSpec(name="bolt", articulation=Articulation("bolt", (fixed,)), fixed_base=True)
    start = Pose((0.0, 0.0, _LENGTH - _THREAD.lead - _HEIGHT))
    nut = ObjectSpec(name="nut", articulation=Articulation("nut", (moving,)), pose=start)
    world = trial.world(scene(bolt, nut, terrain=()))
    thing = world.objects["nut"]
    rise = _THREAD.lead / (2.0 * math.pi)
    pace = _MASS * G * rise / (_INERTIA + _MASS * rise**2)
    turned, last, curve = 0.0, 0.0, []
    for time in trial.advance(world, 0.9, every=0.02):
        angle = float(yaw_angle(thing.root_pose[0, 3:]))
        turned += math.remainder(angle - last, 2.0 * math.pi)
        last = angle
        curve.append((time, -turned, 0.5 * pace * time**2, float(thing.root_pose[0, 2])))
    times, angles, truth, heights = zip(*curve, strict=True)
    trial.trace("turn", "rad", times, angles, truth)
    early = 12  # by then it rests on the bolt's flanks
    fallen, turns = heights[early] - heights[-1], (angles[-1] - angles[early]) / (2.0 * math.pi)
    share = math.sqrt(max(angles[-1], 0.0) / truth[-1])
    return {"lead": abs(fallen / max(turns, 1e-9) / _THREAD.lead - 1.0), "pace": abs(share - 1.0)}


SCENARIOS = (
    Scenario(
        name="screw",
        group="Contact",
        question="Does a nut go down its bolt by the lead in each turn, as fast as its weight turns it?",
        truth="z = -lead t / 2 pi; t'' = m g p / (I + m p^2), p = lead / 2 pi",
        source="Shigley's Mechanical Engineering Design, 10th ed., section 8-2, without friction",
        judges=(),
        run=_screw,
        metrics=(
            Metric(
                name="lead",
                unit="",
                tolerance=0.015,
                meaning="relative error of the way that it falls in a turn",
                looser_because="boxes along a helix are flat: their flanks stray from it by 12 micrometres",
            ),
            Metric(
                name="pace",
                unit="",
                tolerance=0.05,
                meaning="relative error of the square root of the angle at the end",
                looser_because="it drops by 0.2 mm of play until flanks meet, and hits edges of boxes as it turns",
            ),
        ),
    ),
)
