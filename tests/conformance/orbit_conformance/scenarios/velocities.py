"""Scenario that reported velocities are those at which bodies move."""

from __future__ import annotations

from collections.abc import Mapping

import torch
from torch import Tensor

from orbit_conformance.bodies import cube, on_slope, pendulum, scene, slope
from orbit_conformance.contact import SMOOTH_GROUND, block, smooth_material
from orbit_conformance.scenario import Metric, Scenario, Trial
from orbit_conformance.scenarios.grasp import FRICTION, HALF, MASS, gripper, lift, squeeze
from orbit_core.dynamics.transforms import pose_error
from orbit_core.interfaces import Capability, World
from orbit_core.scene import Pose


def _poses_and_velocities(world: World) -> tuple[Tensor, Tensor]:
    """Poses (bodies, 7) and velocities (bodies, 6) of all links of all entities, in double precision."""
    things = [*world.objects.values(), *world.robots.values()]
    poses = torch.cat([thing.link_poses[0] for thing in things])
    velocities = torch.cat([thing.link_velocities[0] for thing in things])
    return poses.double().cpu(), velocities.double().cpu()


def _untruth(trial: Trial, world: World, steps: int) -> float:
    """Largest difference of reported velocities, means of a step's begin and end, from the links' motion in the step.

    In m/s, and rad/s, whichever is more.
    """
    worst = 0.0
    poses, told = _poses_and_velocities(world)
    for _ in range(steps):
        trial.step(world)
        next_poses, next_told = _poses_and_velocities(world)
        moved = pose_error(poses, next_poses) / trial.time_step
        worst = max(worst, float((moved - 0.5 * (told + next_told)).abs().max()))
        poses, told = next_poses, next_told
    return worst


def _velocity_told(trial: Trial) -> Mapping[str, float]:
    material = smooth_material(FRICTION)
    tower = [
        cube(f"cube{layer}", 0.05, mass, Pose((0.0, 0.0, 0.05 + 0.1 * layer)), material)
        for layer, mass in enumerate((1.0, 1.0, 10.0))
    ]
    resting = trial.world(scene(*tower, terrain=SMOOTH_GROUND))
    trial.step(resting, trial.steps(0.5))

    ramp = slope(0.3, material)
    leaning = trial.world(scene(cube("held", 0.05, 1.0, on_slope(0.3, 0.05), material), terrain=(ramp,)))
    trial.step(leaning, trial.steps(0.5))

    thing = block("box", 2 * HALF, material, Pose((0.0, 0.0, HALF)), MASS)
    grasping = trial.world(scene(gripper(material), thing, terrain=SMOOTH_GROUND))
    squeeze(grasping, torch.full((1,), 0.5))
    trial.step(grasping, trial.steps(0.2))
    lift(trial, grasping)
    trial.step(grasping, trial.steps(0.2))

    thrown = cube("thrown", pose=Pose((1.0, 0.0, 1.0)), center_of_mass=(0.04, 0.0, 0.0))
    flying = trial.world(scene(thrown, pendulum(base=Pose((0.0, 0.0, 1.0))), terrain=()))
    flying.objects["thrown"].set_root_velocity(torch.tensor([[1.0, -0.5, 3.0, 4.0, 6.0, -3.0]], device=flying.device))
    trial.step(flying)
    steps = trial.steps(0.2)
    return {
        "resting": max(_untruth(trial, world, steps) for world in (resting, leaning)),
        "grasp": _untruth(trial, grasping, steps),
        "moving": _untruth(trial, flying, steps),
    }


_UNSEEN = "a millimetre a second is unseen; the best is at rounding error"

SCENARIOS = (
    Scenario(
        name="velocity_told",
        group="Rest",
        question="Are the velocities that are told those at which bodies move: at rest under load, held, in flight?",
        truth="(pose after a step - pose before) / time step = mean of the velocities told at both",
        source="Goldstein, Classical Mechanics, 3rd ed., section 1.1 (the definition of velocity)",
        needs=(Capability.IMPLICIT_DRIVES,),
        run=_velocity_told,
        metrics=(
            Metric(
                name="resting",
                unit="m/s",
                tolerance=1e-3,
                meaning="largest difference, of a tower under load and of a box on a slope; rad/s for rotation",
                looser_because=_UNSEEN,
            ),
            Metric(
                name="grasp",
                unit="m/s",
                tolerance=1e-3,
                meaning="the same of a box held by two fingers, and of these",
                looser_because=_UNSEEN,
            ),
            Metric(
                name="moving",
                unit="m/s",
                tolerance=0.15,
                meaning="the same of a spinning body in flight and of a falling double pendulum",
            ),
        ),
    ),
)
