"""Scenario of the distance at which two things touch."""

from __future__ import annotations

import math
from collections.abc import Mapping

import torch

from orbit_assets.rods import ring_on_handle
from orbit_conformance.bodies import WEIGHTLESS, fixed, scene
from orbit_conformance.contact import contact_sensor
from orbit_conformance.scenario import Metric, Scenario, Trial
from orbit_core.interfaces import Capability
from orbit_core.scene import Capsule, ContactSensorSpec, ObjectSpec, Pose

_ROD, _BAR, _RADIUS, _REACH = 0.006, 0.004, 0.035, 0.14
# Metres between the rod and the ring's bar at first, such that they meet at different times within a step.
_STARTS = (1.0e-3, 1.53e-3, 2.06e-3, 2.59e-3)
# m/s: a tenth of a millimetre in a step.
_SPEED = 0.02


def _ring_on_rod(trial: Trial) -> Mapping[str, float]:
    """A weightless ring goes slowly towards the rod in it, until a sensor reports force between them."""
    ring = ObjectSpec(name="ring", articulation=ring_on_handle("ring", _RADIUS, _BAR, _REACH))
    rod = fixed("rod", Capsule(_ROD, 0.2), Pose.from_axis_angle((1.0, 0.0, 0.0), 0.5 * math.pi))
    sensor = ContactSensorSpec(name="touch", entity="ring", filters=("rod",))
    world = trial.world(scene(ring, rod, sensors=(sensor,), terrain=(), gravity=WEIGHTLESS), len(_STARTS))
    body, starts = world.objects["ring"], torch.tensor(_STARTS, device=world.device)
    # The joint of two bars that is nearest to the handle comes from below to the rod, whose axis is at z = 0.
    meeting = -(_REACH - _RADIUS) - _BAR - _ROD
    pose, velocity = (
        torch.zeros(len(_STARTS), 7, device=world.device),
        torch.zeros(len(_STARTS), 6, device=world.device),
    )
    pose[:, 2], pose[:, 3], velocity[:, 2] = meeting - starts, 1.0, _SPEED
    body.set_root_pose(pose)
    body.set_root_velocity(velocity)
    gaps = torch.full_like(starts, torch.nan)
    for _ in trial.advance(world, 0.25):
        forces = contact_sensor(world, "touch").filtered_forces.flatten(1).norm(dim=1)
        gaps = torch.where((forces > 1e-6) & gaps.isnan(), meeting - body.root_pose[:, 2], gaps)
    gaps = gaps.nan_to_num(-_SPEED * 0.25)
    return {"early": max(0.0, float(gaps.max())), "late": max(0.0, -float(gaps.min()))}


SCENARIOS = (
    Scenario(
        name="ring_on_rod",
        group="Contact",
        question="Does a ring around a rod touch it where their surfaces meet, and not before?",
        truth="force from where the gap between their surfaces is zero, at 0.02 m/s",
        source="the geometry of two capsules: the distance of their axes less both radii",
        judges=(Capability.CONTACT_FORCES,),
        run=_ring_on_rod,
        metrics=(
            Metric(
                name="early",
                unit="m",
                tolerance=1.5e-4,
                meaning="largest gap at the end of the first step in which there is a force",
                looser_because="a step and a half of the way; engines that wait for an overlap are never early",
            ),
            Metric(
                name="late",
                unit="m",
                tolerance=2e-4,
                meaning="deepest overlap then; 5 mm where there never is a force",
                looser_because="two steps of the way; engines that foresee the contact are never late",
            ),
        ),
    ),
)
