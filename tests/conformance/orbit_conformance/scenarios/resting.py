"""Things at rest: weights, a stack, a heap."""

from __future__ import annotations

from collections.abc import Mapping

import torch

from orbit_conformance.bodies import SMOOTH, G, cube, scene
from orbit_conformance.contact import (
    HEIGHT,
    SMOOTH_GROUND,
    contact_sensor,
    marble,
    positions,
    smooth_material,
    standing_solids,
    velocities,
)
from orbit_conformance.scenario import Metric, Scenario, Trial
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
    trial.step(world, trial.steps(2.0))
    before = positions(world)[0]
    trial.step(world, trial.steps(1.0))
    drift = (positions(world)[0] - before).norm(dim=-1).max()
    weight = contact_sensor(world, "ground").filtered_forces[0, 0, 0, 2].item()
    settled = positions(world)[0]
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
    spacing = 2.15 * radius
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
)
