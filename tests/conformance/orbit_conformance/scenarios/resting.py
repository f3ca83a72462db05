"""Scenarios of rest: weights, stacks and towers, and the velocities that are reported at rest and in motion."""

from __future__ import annotations

import math
from collections.abc import Mapping

import torch
from torch import Tensor

from orbit_assets.objects import box
from orbit_conformance.bodies import (
    HEIGHT,
    SMOOTH,
    SMOOTH_GROUND,
    G,
    block,
    contact_sensor,
    cube,
    marble,
    on_slope,
    pendulum,
    positions,
    scene,
    slope,
    smooth_material,
    standing_solids,
    velocities,
)
from orbit_conformance.scenario import Metric, Scenario, Trial
from orbit_conformance.scenarios.grasp import FRICTION, HALF, MASS, gripper, lift, squeeze
from orbit_core.dynamics.transforms import pose_error
from orbit_core.interfaces import Capability, World
from orbit_core.scene import Box, ContactSensorSpec, PhysicsMaterial, Pose, Shape

_HALF = 0.05


def _kinetic_energy(world: World, mass: float, inertia: float) -> float:
    """Kinetic energy in J of all objects of the first environment, each of one mass and one moment of inertia."""
    linear, angular = velocities(world)[0].split(3, dim=-1)
    return float(0.5 * mass * linear.square().sum() + 0.5 * inertia * angular.square().sum())


def _weights(trial: Trial) -> Mapping[str, float]:
    forces, depths, drifts = [], [], []
    for mass in (0.1, 10.0):
        solids = standing_solids(smooth_material(0.5), mass=mass)
        sensors = tuple(ContactSensorSpec(name=solid.name, entity=solid.name) for solid in solids)
        world = trial.world(scene(*solids, terrain=SMOOTH_GROUND, sensors=sensors))
        trial.step(world, trial.steps(0.3))
        before = positions(world)
        for _ in range(10):
            trial.step(world, trial.steps(0.05))
            measured = torch.stack([contact_sensor(world, solid.name).forces[0, 0] for solid in solids])
            forces.append((measured - torch.tensor([0.0, 0.0, mass * G])).norm(dim=-1).max() / (mass * G))
        after = positions(world)
        drifts.append((after - before)[..., :2].norm(dim=-1).max())
        depths.append((after[..., 2] - HEIGHT / 2).abs().max())
    return {"force": float(max(forces)), "depth": float(max(depths)), "drift": float(max(drifts))}


def _stack(trial: Trial) -> Mapping[str, float]:
    count, mass = 10, 1.0
    cubes = [
        cube(f"cube{i}", _HALF, mass, Pose((0.0, 0.0, _HALF + 2 * _HALF * i)), smooth_material(0.5))
        for i in range(count)
    ]
    sensors = (ContactSensorSpec(name="ground", entity="cube0", filters=("terrain",)),)
    world = trial.world(scene(*cubes, terrain=SMOOTH_GROUND, sensors=sensors))
    # A tower of ten cubes trembles for some time before it rests.
    trial.step(world, trial.steps(2.0))
    before = positions(world)[0]
    trial.step(world, trial.steps(1.0))
    drift = (positions(world)[0] - before).norm(dim=-1).max()
    weight = contact_sensor(world, "ground").filtered_forces[0, 0, 0, 2].item()
    settled = positions(world)[0]
    # Heights relative to the cube below: how far each layer has sunk into the next.
    layers = torch.diff(torch.cat((torch.tensor([-_HALF]), settled[:, 2]))) - 2 * _HALF
    return {
        "penetration": float(-layers.min()),
        "drift": float(drift),
        "lean": float(settled[:, :2].norm(dim=-1).max()),
        "weight": abs(weight / (count * mass * G) - 1),
        "energy": _kinetic_energy(world, mass, mass * (2 * _HALF) ** 2 / 6) / (mass * G * _HALF),
    }


def _heap(trial: Trial) -> Mapping[str, float]:
    side, radius, mass = 6, 0.05, 0.5
    inside = side * radius * 1.1  # half the bin's width
    # 7.5 % more than touching, and a little noise: balls fall into a heap, not into a crystal.
    spacing = 2.15 * radius
    # The same heap on every engine.
    generator = torch.Generator().manual_seed(7)
    grid = torch.cartesian_prod(*[torch.arange(side)] * 3).double()
    centers = (grid - (side - 1) / 2) * spacing
    centers[:, 2] = radius * 1.05 + grid[:, 2] * spacing
    centers += radius * 0.05 * (2 * torch.rand(centers.shape, generator=generator, dtype=torch.float64) - 1)
    material = PhysicsMaterial(0.3, 0.3, 0.0, 0.0)
    balls = [
        marble(f"ball{i}", radius, material, Pose((x, y, z)), mass) for i, (x, y, z) in enumerate(centers.tolist())
    ]
    world = trial.world(scene(*balls, terrain=(*SMOOTH_GROUND, *_bin(inside, 1.0))))
    trial.step(world, trial.steps(1.2))
    centers = positions(world)[0]
    # Expanding the square, cdist's default, would lose the overlap of a micrometre in rounding.
    distances = torch.cdist(centers, centers, compute_mode="donot_use_mm_for_euclid_dist")
    distances.fill_diagonal_(1.0)
    overlaps = torch.cat(
        (2 * radius - distances.flatten(), radius - centers[:, 2], centers[:, :2].abs().flatten() + radius - inside)
    )
    return {
        "penetration": float(overlaps.max()) / radius,
        "energy": _kinetic_energy(world, mass, 0.4 * mass * radius**2) / (len(balls) * mass * G * radius),
    }


def _bin(inside: float, height: float) -> tuple[Shape, ...]:
    thick = 0.1
    return tuple(
        Shape(
            Box((thick, inside + 2 * thick, height) if x else (inside + 2 * thick, thick, height)),
            Pose((x * (inside + thick), y * (inside + thick), height)),
            SMOOTH,
            name=f"wall{number}",
        )
        for number, (x, y) in enumerate(((1, 0), (-1, 0), (0, 1), (0, -1)))
    )


_CUBE_HALF, _COUNT, _APART = 0.05, 5, 1.0
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
            _CUBE_HALF,
            load if layer == _COUNT else 1.0,
            Pose((_APART * tower, 0.0, _CUBE_HALF + 2 * _CUBE_HALF * layer)),
            smooth_material(0.5),
        )
        for tower, load in enumerate(_LOADS)
        for layer in range(_COUNT + 1)
    ]
    world = trial.world(scene(*cubes, terrain=SMOOTH_GROUND))
    curve, sinks, leans = [], [0.0] * len(_LOADS), [0.0] * len(_LOADS)
    start = positions(world)[0].cpu()
    # Soft contacts creep for seconds under a hundredfold load: a look after one second would pass them.
    for time in trial.advance(world, 8.0, every=0.1):
        places = positions(world)[0].cpu()
        for tower, (now, before) in enumerate(zip(places.chunk(len(_LOADS)), start.chunk(len(_LOADS)), strict=True)):
            heights = torch.cat((torch.tensor([-_CUBE_HALF]), now[:, 2]))
            sinks[tower] = max(sinks[tower], float((2 * _CUBE_HALF - heights.diff()).max()))
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
            # Widths on both sides of the one that topples on this slope, so that the limit itself is measured.
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
    # The top block of a fallen tower has moved by more than half a storey.
    fallen = moved[:, -1] > 0.5 * _STOREY
    steepness = torch.tensor(_STEEPNESS)
    wrong = (steepness - 1.0).abs()[fallen != (steepness > 1.0)]
    # Towers near the limit may lean a little; creep is measured on those that stand safely.
    standing = moved[steepness < 0.9]
    return {"tilt": float(wrong.max()) if len(wrong) else 0.0, "creep": float(standing.max()) / 2.0}


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
        # Motion by poses is the truth: reported velocities may hide a constraint's correction.
        moved = pose_error(poses, next_poses) / trial.time_step
        worst = max(worst, float((moved - 0.5 * (told + next_told)).abs().max()))
        poses, told = next_poses, next_told
    return worst


def _velocity_told(trial: Trial) -> Mapping[str, float]:
    material = smooth_material(FRICTION)
    tower = [
        cube(f"cube{layer}", 0.05, mass, Pose((0.0, 0.0, 0.05 + 0.1 * layer)), material)
        # A heavy load on top makes position corrections of the layers below large.
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
        name="resting_weight",
        group="Rest",
        question="Does the ground bear the weight of what stands on it, without trembling, sinking or creeping?",
        truth="m g upwards at any time, at the height where it was put; 0.1 and 10 kg, four shapes",
        source="Goldstein, Classical Mechanics, 3rd ed., section 1.4 (equilibrium)",
        needs=(Capability.CONTACT_FORCES,),
        run=_weights,
        metrics=(
            Metric(
                name="force",
                unit="",
                tolerance=2e-3,
                meaning="largest error, over the weight, of any mean over 50 ms within 0.5 s",
                looser_because="the best is at rounding error",
            ),
            Metric(
                name="depth",
                unit="m",
                tolerance=2e-4,
                meaning="largest distance of a height from where things were put",
                looser_because="the best is at rounding error",
            ),
            Metric(
                name="drift",
                unit="m",
                tolerance=5e-5,
                meaning="largest way sideways within 0.5 s",
                looser_because="the best is at rounding error; where an iterative solver stops turns on a processor's "
                "rounding: with one engine 1.1e-5 m on one machine is 3.3e-5 m on another",
            ),
        ),
    ),
    Scenario(
        name="stack",
        group="Rest",
        question="Does a tower of ten cubes stand?",
        truth="every cube at rest, 0.1 m above the one below, the lowest bearing ten weights",
        source="Goldstein, Classical Mechanics, 3rd ed., section 1.4 (equilibrium)",
        needs=(Capability.CONTACT_FORCES,),
        run=_stack,
        metrics=(
            Metric(
                name="penetration",
                unit="m",
                tolerance=2e-4,
                meaning="greatest overlap of two neighbours after 3 s",
                looser_because="the best overlaps by a fifth of its contacts' rest offset; 0.2 % of a side is unseen",
            ),
            Metric(
                name="drift",
                unit="m",
                tolerance=2e-4,
                meaning="longest way of a cube in the third second",
                looser_because="the best is at rounding error",
            ),
            Metric(
                name="lean",
                unit="m",
                tolerance=1e-3,
                meaning="greatest distance from the vertical after 3 s",
                looser_because="one per cent of a side, of a tower ten sides tall",
            ),
            Metric(
                name="weight",
                unit="",
                tolerance=1e-3,
                meaning="relative error of the ground's force on the lowest",
                looser_because="the best is at rounding error",
            ),
            Metric(
                name="energy",
                unit="",
                tolerance=5e-3,
                meaning="kinetic energy after 3 s, over m g a of one cube",
                looser_because="the best is at rounding error",
            ),
        ),
    ),
    Scenario(
        name="heap",
        group="Rest",
        question="Do 216 balls, let go in a bin, come to rest within it and within each other's surfaces?",
        truth="no overlap, no kinetic energy, none outside",
        source="Goldstein, Classical Mechanics, 3rd ed., section 1.4 (equilibrium)",
        run=_heap,
        time_step=0.01,
        time_steps=(),
        slow=True,
        metrics=(
            Metric(
                name="penetration",
                unit="",
                tolerance=0.02,
                meaning="greatest overlap at 1.2 s, over the radius",
                looser_because="a hundredth of a diameter is unseen in a heap",
            ),
            Metric(
                name="energy",
                unit="",
                tolerance=0.01,
                meaning="kinetic energy at 1.2 s, over m g r of all",
                looser_because="balls still roll into gaps for a while",
            ),
        ),
    ),
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
