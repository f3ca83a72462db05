"""Elastic solids on rigid ones: they hold and slide on a slope, are held by two fingers, and bear what is on them."""

from __future__ import annotations

import math
from collections.abc import Mapping

import torch

from orbit_assets.deformables import cuboid
from orbit_conformance.bodies import G, cube, on_slope, slope
from orbit_conformance.scenario import Metric, Scenario, Trial
from orbit_conformance.scenarios.grasp import HALF, gripper
from orbit_conformance.scenarios.ropes import GROUP, TIME_STEPS, weight_error
from orbit_conformance.scenarios.solids import PUBLISHED, RATIO
from orbit_core.interfaces import Capability
from orbit_core.scene import PhysicsMaterial, Pose, Scene, SoftBody

MODULUS, DENSITY, SIDE = 2e5, 500.0, 2.0 * HALF
FRICTION = 0.4
HOLDING, SLIDING = 0.34, 0.6
"""Tangents of the slopes: below the first a block of this softness holds with all of its base."""


def _block(pose: Pose, friction: float = FRICTION) -> SoftBody:
    mesh = cuboid((SIDE, SIDE, SIDE), (2, 2, 2))
    return SoftBody("block", mesh, DENSITY, pose, MODULUS, RATIO, 0.005, friction)


def _slope(trial: Trial) -> Mapping[str, float]:
    crept, _ = _slid(trial, HOLDING)
    _, acceleration = _slid(trial, SLIDING)
    angle = math.atan(SLIDING)
    truth = G * (math.sin(angle) - FRICTION * math.cos(angle))
    return {"creep": crept, "acceleration": abs(acceleration / truth - 1.0)}


def _slid(trial: Trial, tangent: float) -> tuple[float, float]:
    """Metres a second and m/s^2 of a block on a slope, over 0.4 s."""
    angle, duration = math.atan(tangent), 0.4
    ground = slope(angle, PhysicsMaterial(FRICTION, FRICTION))
    world = trial.world(Scene(deformables=(_block(on_slope(angle, HALF)),), terrain=(ground,)))
    body = world.deformables["block"]
    # Until it has slid into the shape that it keeps.
    trial.step(world, trial.steps(0.3))
    before, speed = body.positions[0].mean(0).clone(), body.velocities[0].mean(0).norm().clone()
    trial.step(world, trial.steps(duration))
    moved = float((body.positions[0].mean(0) - before).norm())
    return moved / duration, float(body.velocities[0].mean(0).norm() - speed) / duration


def _grasp(trial: Trial) -> Mapping[str, float]:
    """Two fingers close on a block with 5 N each, lift it off the ground and hold it."""
    world = trial.world(
        Scene(robots=(gripper(PhysicsMaterial(1.0, 1.0)),), deformables=(_block(Pose((0, 0, HALF)), 1.0),))
    )
    robot, body = world.robots["gripper"], world.deformables["block"]
    robot.set_effort_targets(torch.full((1, 2), 5.0, device=world.device), [1, 2])
    # Until the fingers have closed over the gap and squeezed the block.
    trial.step(world, trial.steps(0.4))
    for time in trial.advance(world, 0.5):
        robot.set_position_targets(torch.full((1, 1), 0.2 * time, device=world.device), [0])

    def height() -> float:
        return float(body.positions[0, :, 2].mean() - robot.link_poses[0, 2:, 2].mean())

    before = height()
    error = weight_error(trial, world, "block", [("gripper", "left"), ("gripper", "right")])
    return {"force": error, "slip": abs(height() - before)}


def _load(trial: Trial) -> Mapping[str, float]:
    """A box of the block's own weight falls on it from 5 mm, and rests on it."""
    mass, half = DENSITY * SIDE**3, 0.025
    box = cube("box", half, mass, Pose((0.0, 0.0, SIDE + half + 0.005)))
    world = trial.world(Scene(objects=(box,), deformables=(_block(Pose((0.0, 0.0, HALF))),)))
    # A fall of 5 mm has been damped by then.
    trial.step(world, trial.steps(1.0))
    felt, speed, count = 0.0, 0.0, trial.steps(0.3)
    for _ in range(count):
        trial.step(world)
        speed = max(speed, float(world.objects["box"].root_velocity[0, :3].norm()))
        felt += float(world.deformables["block"].contact_force("box", "box")[0, 2]) / count
    return {"force": abs(felt / (G * mass) - 1.0), "speed": speed}


# Seconds, as in tasks.
_FINGERS_STEP = 0.0025

SCENARIOS = (
    Scenario(
        name="solid_slope",
        group=GROUP,
        question="Does a soft block hold on a slope below the angle of friction, and slide as Coulomb says above?",
        truth=f"it holds at tan {HOLDING}; at tan {SLIDING} it slides with g (sin - mu cos); mu = {FRICTION}",
        source="Meriam and Kraige, Statics, section 6/3; Dynamics, section 3/4",
        needs=(Capability.SOFT_BODIES,),
        judges=(Capability.SOFT_BODIES,),
        time_steps=TIME_STEPS,
        run=_slope,
        metrics=(
            Metric(
                name="creep",
                unit="m/s",
                tolerance=1e-3,
                meaning="mean speed over 0.4 s on the lesser slope",
                looser_because=PUBLISHED,
            ),
            Metric(
                name="acceleration",
                unit="",
                tolerance=0.03,
                meaning="its relative error over 0.4 s on the steeper slope",
                looser_because=PUBLISHED,
            ),
        ),
    ),
    Scenario(
        name="solid_grasp",
        group=GROUP,
        question="Do two fingers that hold a soft block feel its weight, and does it stay?",
        truth="m g down on both fingers together, and nothing across",
        source="equilibrium of forces",
        needs=(Capability.SOFT_BODIES,),
        judges=(Capability.SOFT_BODIES,),
        time_step=_FINGERS_STEP,
        time_steps=TIME_STEPS,
        run=_grasp,
        metrics=(
            Metric(
                name="force",
                unit="",
                tolerance=0.02,
                meaning="error of the mean force on both fingers over the weight",
                looser_because=PUBLISHED,
            ),
            Metric(
                name="slip",
                unit="m",
                tolerance=5e-4,
                meaning="how far its middle moves between the fingers in 1.5 s",
                looser_because=PUBLISHED,
            ),
        ),
    ),
    Scenario(
        name="solid_load",
        group=GROUP,
        question="Does a box that falls on a soft block of its own weight stay at rest on it?",
        truth="m g up, and no speed, after 1 s",
        source="equilibrium of forces",
        needs=(Capability.SOFT_BODIES,),
        judges=(Capability.SOFT_BODIES,),
        time_steps=TIME_STEPS,
        run=_load,
        metrics=(
            Metric(
                name="force",
                unit="",
                tolerance=0.02,
                meaning="error of the mean force of the block on it, over its weight",
                looser_because=PUBLISHED,
            ),
            Metric(
                name="speed",
                unit="m/s",
                tolerance=0.01,
                meaning="its largest speed in 0.3 s after that",
                looser_because="a centimetre in a second is rest for every purpose",
            ),
        ),
    ),
)
