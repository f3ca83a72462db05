"""Scenarios of contact sensors."""

from __future__ import annotations

import math
from collections.abc import Mapping

import torch

from orbit_assets.objects import box
from orbit_conformance.bodies import (
    SMOOTH,
    SMOOTH_GROUND,
    WEIGHTLESS,
    G,
    contact_sensor,
    fixed,
    marble,
    on_slope,
    scene,
    slope,
    smooth_material,
    standing_solids,
)
from orbit_conformance.scenario import Metric, Scenario, Trial
from orbit_core.interfaces import Capability
from orbit_core.scene import Box, ContactSensorSpec, Pose

RADIUS = 0.05


def _sandwich(trial: Trial) -> Mapping[str, float]:
    """A plate of 2 kg on a fixed table, 1 kg and 3 kg on the plate; a bystander apart."""
    material = smooth_material(0.5)
    # The plate bears two loads and rests on a third body: net force and pair forces differ in sign and size.
    table = fixed("table", Box((0.5, 0.5, 0.05)), Pose((0.0, 0.0, 0.05)), material)
    plate = box("plate", (0.4, 0.2, 0.04), mass=2.0, material=material, pose=Pose((0.0, 0.0, 0.12)))
    light = box("light", (0.1, 0.1, 0.1), mass=1.0, material=material, pose=Pose((-0.1, 0.0, 0.19)))
    heavy = box("heavy", (0.1, 0.1, 0.1), mass=3.0, material=material, pose=Pose((0.1, 0.0, 0.19)))
    bystander = box("bystander", (0.1, 0.1, 0.1), mass=1.0, material=material, pose=Pose((1.0, 0.0, 0.05)))
    filters = ("table", "light", "heavy", "bystander", "terrain")
    world = trial.world(
        scene(
            table, plate, light, heavy, bystander, terrain=SMOOTH_GROUND,
            sensors=(ContactSensorSpec(name="plate", entity="plate", filters=filters),),
        )
    )  # fmt: skip
    # One second for the stack to settle; then a sensor's mean over a tenth of a second.
    trial.step(world, trial.steps(1.0))
    trial.step(world, trial.steps(0.1))
    sensor = contact_sensor(world, "plate")
    # The table bears all 6 kg, the loads press with 1 and 3 kg, the bystander and the ground touch nothing.
    truth = torch.tensor([6.0, -1.0, -3.0, 0.0, 0.0]) * G
    up = torch.tensor([0.0, 0.0, 1.0])
    weight = 6.0 * G
    return {
        "net": float((sensor.forces[0, 0] - 2.0 * G * up).norm()) / weight,
        "pairs": float((sensor.filtered_forces[0, 0] - truth[:, None] * up).norm(dim=-1).max()) / weight,
    }


def _held_on_slope(trial: Trial) -> Mapping[str, float]:
    # Held below the angle of friction: normal force and friction add up to the weight, straight up.
    angle, mu = math.atan(0.4), 0.5
    solids = standing_solids(smooth_material(mu), on_slope(angle, 0.0))
    sensors = tuple(ContactSensorSpec(name=s.name, entity=s.name, filters=("terrain",)) for s in solids)
    world = trial.world(scene(*solids, terrain=(slope(angle, SMOOTH),), sensors=sensors))
    trial.step(world, trial.steps(0.5))
    trial.step(world, trial.steps(0.2))
    forces = torch.stack([contact_sensor(world, s.name).filtered_forces[0, 0, 0] for s in solids])
    return {"force": float((forces / G - torch.tensor([0.0, 0.0, 1.0])).norm(dim=-1).max())}


def _impulses(trial: Trial) -> Mapping[str, float]:
    """A ball flies into one at rest that stands free: what each sensor adds up is what each momentum gains."""
    errors = {"net": 0.0, "pairs": 0.0, "reaction": 0.0}
    masses = {"one": 1.0, "other": 2.0}
    for restitution in (0.0, 0.7):
        material = smooth_material(0.0, restitution)
        # Off centre by 1 cm: the impact's normal is no axis of the world.
        one = marble("one", RADIUS, material, Pose((0.0, 0.01, 0.0)))
        other = marble("other", RADIUS, material, Pose((0.15, 0.0, 0.0)), masses["other"])
        sensors = (
            ContactSensorSpec(name="one", entity="one", filters=("other",)),
            ContactSensorSpec(name="other", entity="other", filters=("one",)),
        )
        world = trial.world(scene(one, other, terrain=(), gravity=WEIGHTLESS, sensors=sensors))
        speed = 2.0
        world.objects["one"].set_root_velocity(torch.tensor([[speed, 0.0, 0.0, 0.0, 0.0, 0.0]]))
        sums = torch.zeros(2, 2, 3)
        period = 0.02
        for _ in range(10):
            trial.step(world, trial.steps(period))
            for row, name in enumerate(masses):
                sensor = contact_sensor(world, name)
                sums[row] += period * torch.stack((sensor.forces[0, 0], sensor.filtered_forces[0, 0, 0]))
        gained = torch.stack(
            (world.objects["one"].root_velocity[0, :3], 2.0 * world.objects["other"].root_velocity[0, :3])
        )
        # Gains of momentum: the first ball had all of it before the impact.
        gained[0, 0] -= speed
        size = gained.norm(dim=-1).max()
        errors["net"] = max(errors["net"], float((sums[:, 0] - gained).norm(dim=-1).max() / size))
        errors["pairs"] = max(errors["pairs"], float((sums[:, 1] - gained).norm(dim=-1).max() / size))
        errors["reaction"] = max(errors["reaction"], float(sums[:, 0].sum(0).norm() / size))
    return errors


def _landing(trial: Trial) -> Mapping[str, float]:
    """The mean force on a ball that falls and settles is its change of momentum over time plus its weight."""
    ball = marble("marble", RADIUS, smooth_material(0.0), Pose((0.0, 0.0, RADIUS + 0.2)), 2.0)
    sensors = (ContactSensorSpec(name="touch", entity="marble", filters=("terrain",)),)
    world = trial.world(scene(ball, terrain=SMOOTH_GROUND, sensors=sensors))
    body, sensor = world.objects["marble"], contact_sensor(world, "touch")
    times, measured, truth = [], [], []
    speed, period = 0.0, 0.02
    for count in range(1, 31):
        trial.step(world, trial.steps(period))
        after = body.root_velocity[0, 2].item()
        times.append(period * count)
        measured.append(sensor.forces[0, 0, 2].item())
        # The mean force over the period follows from the change of momentum, however short the peak in it was.
        truth.append(2.0 * ((after - speed) / period + G))
        speed = after
    trial.trace("force", "N", times, measured, truth)
    error = (torch.tensor(measured) - torch.tensor(truth)).abs().max()
    return {"force": float(error / torch.tensor(truth).max())}


_NEWTON = "Goldstein, Classical Mechanics, 3rd ed., section 1.1 (Newton's second and third laws)"

SCENARIOS = (
    Scenario(
        name="contact_force_pairs",
        group="Contact forces",
        question="Are the forces of the things that touch one told apart?",
        truth="a plate of 2 kg on a table under 1 kg and 3 kg: 6 g, -1 g, -3 g, nothing else; their sum 2 g",
        source=_NEWTON,
        needs=(Capability.CONTACT_FORCES,),
        judges=(Capability.CONTACT_FORCES,),
        run=_sandwich,
        metrics=(
            Metric(
                name="net",
                unit="",
                tolerance=1e-3,
                meaning="error of the net force, over the load on the table",
                looser_because="the best is at rounding error",
            ),
            Metric(
                name="pairs",
                unit="",
                tolerance=1e-3,
                meaning="largest error of a pair's force, likewise",
                looser_because="the best is at rounding error",
            ),
        ),
    ),
    Scenario(
        name="contact_force_with_friction",
        group="Contact forces",
        question="Is friction part of the contact force?",
        truth="what a slope exerts on a thing that it holds is m g upwards, normal force and friction together",
        source=_NEWTON,
        needs=(Capability.CONTACT_FORCES,),
        judges=(Capability.CONTACT_FORCES,),
        run=_held_on_slope,
        metrics=(
            Metric(
                name="force",
                unit="",
                tolerance=1e-3,
                meaning="largest error over the weight, of four shapes",
                looser_because="a force sensor is hardly ever as good",
            ),
        ),
    ),
    Scenario(
        name="contact_impulses",
        group="Contact forces",
        question="Do the forces of an impact add up to the momentum that it gives, and to nothing between the two?",
        truth="sum of F dt = change of momentum; equal and opposite on the other; e of 0 and 0.7",
        source=_NEWTON,
        needs=(Capability.CONTACT_FORCES, Capability.RESTITUTION),
        judges=(Capability.CONTACT_FORCES,),
        run=_impulses,
        metrics=(
            Metric(
                name="net",
                unit="",
                tolerance=1e-4,
                meaning="relative error of the sum of net forces",
                looser_because="engines in single precision solve an impact to some 1e-5",
            ),
            Metric(
                name="pairs",
                unit="",
                tolerance=1e-4,
                meaning="relative error of the sum of the pair's forces",
                looser_because="engines in single precision solve an impact to some 1e-5",
            ),
            Metric(
                name="reaction",
                unit="",
                tolerance=1e-5,
                meaning="what remains of the two, over one",
                looser_because="the best is at rounding error",
            ),
        ),
    ),
    Scenario(
        name="landing_force",
        group="Contact forces",
        question="Is the force the mean over the sensor's period, while a ball lands?",
        truth="m (dv / T + g) in every period T",
        source=_NEWTON,
        needs=(Capability.CONTACT_FORCES,),
        judges=(Capability.CONTACT_FORCES,),
        run=_landing,
        metrics=(
            Metric(
                name="force",
                unit="",
                tolerance=1e-5,
                meaning="largest error, over the largest force",
                looser_because="the best is at rounding error",
            ),
        ),
    ),
)
