"""At what distance two things touch."""

from __future__ import annotations

import math
from collections.abc import Mapping

import torch

from orbit_core.assets.rods import ring_on_handle
from orbit_core.conformance.bodies import WEIGHTLESS, fixed, scene
from orbit_core.conformance.contact import contact_sensor
from orbit_core.conformance.scenario import Metric, Scenario, Trial
from orbit_core.interfaces import Capability
from orbit_core.scene import Capsule, ContactSensorSpec, ObjectSpec, Pose

_ROD, _BAR, _RADIUS, _REACH = 0.006, 0.004, 0.035, 0.14
_GAPS = (-2e-3, -1e-3, -5e-4, -2e-4, 2e-4, 5e-4, 1e-3, 2e-3, 5e-3, 1e-2)
"""Metres between the rod and the ring's bar; overlaps where negative."""


def _ring_on_rod(trial: Trial) -> Mapping[str, float]:
    """A weightless ring at rest around a rod, nearer to it in each environment; touch is what the sensor reports."""
    ring = ObjectSpec(name="ring", articulation=ring_on_handle("ring", _RADIUS, _BAR, _REACH))
    rod = fixed("rod", Capsule(_ROD, 0.2), Pose.from_axis_angle((1.0, 0.0, 0.0), 0.5 * math.pi))
    sensor = ContactSensorSpec(name="touch", entity="ring", filters=("rod",))
    world = trial.world(scene(ring, rod, sensors=(sensor,), terrain=(), gravity=WEIGHTLESS), len(_GAPS))
    gaps = torch.tensor(_GAPS, device=world.device)
    pose = world.objects["ring"].root_pose.clone()
    pose[:] = torch.tensor([0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0], device=world.device)
    # The joint of two bars that is nearest to the handle comes from below to the rod, whose axis is at z = 0.
    pose[:, 2] = -(_REACH - _RADIUS) - _BAR - _ROD - gaps
    world.objects["ring"].set_root_pose(pose)
    trial.step(world)
    touched = contact_sensor(world, "touch").filtered_forces.flatten(1).norm(dim=1) > 1e-6
    early, late = gaps[touched & (gaps > 0.0)], gaps[~touched & (gaps < 0.0)]
    return {"early": float(early.max()) if len(early) else 0.0, "late": -float(late.min()) if len(late) else 0.0}


SCENARIOS = (
    Scenario(
        name="ring_on_rod",
        group="Contact",
        question="Does a ring around a rod touch it where their surfaces meet, and not before?",
        truth="force where the gap is below zero, none above: 0.2 mm to 10 mm apart, 0.2 mm to 2 mm of overlap",
        source="the geometry of two capsules: the distance of their axes less both radii",
        judges=(Capability.CONTACT_FORCES,),
        run=_ring_on_rod,
        metrics=(
            Metric(
                name="early",
                unit="m",
                tolerance=1e-4,
                meaning="largest gap at which a touch is reported",
                looser_because="half of the least gap tried; the best engines report none",
            ),
            Metric(
                name="late",
                unit="m",
                tolerance=1e-4,
                meaning="deepest overlap at which none is reported",
                looser_because="half of the least overlap tried; the best engines report all",
            ),
        ),
    ),
)
