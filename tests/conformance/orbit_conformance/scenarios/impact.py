"""Impacts: rebounds and collisions."""

from __future__ import annotations

import math
from collections.abc import Mapping

import torch
from torch import Tensor

from orbit_conformance.bodies import WEIGHTLESS, G, scene
from orbit_conformance.contact import SMOOTH_GROUND, block, marble, smooth_material
from orbit_conformance.scenario import Metric, Scenario, Trial
from orbit_core.interfaces import Capability
from orbit_core.scene import ObjectSpec, Pose

RADIUS = 0.05
_DROP = 0.5


# Heights in metres, chosen so that impacts fall at different times within a step.
_DROPS = (0.3, 0.37, 0.44, 0.51, 0.58)


def _rebound(trial: Trial, thing: ObjectSpec) -> Tensor:
    """Height to which a thing of half height RADIUS rises after its first bounce, over that of the drop (drops,)."""
    world = trial.world(scene(thing, terrain=SMOOTH_GROUND), len(_DROPS))
    body, drops = world.objects[thing.name], torch.tensor(_DROPS)
    pose = body.root_pose.clone()
    pose[:, 2] = RADIUS + drops
    body.set_root_pose(pose)
    trial.step(world, trial.steps(math.sqrt(2 * max(_DROPS) / G) + 0.08))
    heights, speeds = body.root_pose[:, 2] - RADIUS, body.root_velocity[:, 2]
    return (heights + speeds**2 / (2 * G)) / drops


def _bounce(trial: Trial) -> Mapping[str, float]:
    errors: dict[str, list[float]] = {"ball": [], "box": []}
    for restitution in (0.0, 0.5, 0.9):
        material = smooth_material(0.0, restitution)
        for name, thing in (
            ("ball", marble("marble", RADIUS, material, Pose())),
            ("box", block("box", 2 * RADIUS, material, Pose())),
        ):
            errors[name].append(float((_rebound(trial, thing) - restitution**2).abs().max()))
    return {name: max(values) for name, values in errors.items()}


def _bouncing_on(trial: Trial) -> Mapping[str, float]:
    restitution = 0.8
    ball = marble("marble", RADIUS, smooth_material(0.0, restitution), Pose((0.0, 0.0, _DROP + RADIUS)))
    world = trial.world(scene(ball, terrain=SMOOTH_GROUND))
    body = world.objects["marble"]
    fall = math.sqrt(2 * _DROP / G)
    times, heights, truth = [], [], []
    count = trial.steps(1.5)
    for number in range(1, count + 1):
        trial.step(world)
        time = number * trial.time_step
        times.append(time)
        heights.append(body.root_pose[0, 2].item() - RADIUS)
        truth.append(_height_of_bounces(time, fall, restitution))
    trial.trace("height", "m", times, heights, truth)
    return {"path": float((torch.tensor(heights) - torch.tensor(truth)).abs().max()) / _DROP}


def _height_of_bounces(time: float, fall: float, restitution: float) -> float:
    """The height of a point that falls for ``fall`` seconds and then bounces."""
    speed = G * fall
    if time < fall:
        return 0.5 * G * (fall**2 - time**2)
    time -= fall
    while speed > 1e-3:
        speed *= restitution
        flight = 2 * speed / G
        if time < flight:
            return speed * time - 0.5 * G * time**2
        time -= flight
    return 0.0


def _chain(trial: Trial) -> Mapping[str, float]:
    count, gap, speed = 5, 0.02, 1.0
    material = smooth_material(0.0, 1.0)
    balls = [marble(f"marble{i}", RADIUS, material, Pose((i * (2 * RADIUS + gap), 0.0, 0.0))) for i in range(count)]
    world = trial.world(scene(*balls, terrain=(), gravity=WEIGHTLESS))
    world.objects["marble0"].set_root_velocity(torch.tensor([[speed, 0.0, 0.0, 0.0, 0.0, 0.0]]))
    trial.step(world, trial.steps(0.3))
    speeds = torch.stack([thing.root_velocity[0, :3] for thing in world.objects.values()])
    momentum = speeds.sum(0) - torch.tensor([speed, 0.0, 0.0])
    return {
        "momentum": float(momentum.norm() / speed),
        "energy": abs(float(speeds.square().sum()) / speed**2 - 1),
        "last": abs(float(speeds[-1, 0]) / speed - 1),
        "others": float(speeds[:-1].norm(dim=-1).max()) / speed,
    }


def _unequal(trial: Trial) -> Mapping[str, float]:
    speed, restitution = 1.0, 0.5
    errors, momenta = [], []
    for ratio in (0.1, 3.0, 30.0):
        material = smooth_material(0.0, restitution)
        one = marble("one", RADIUS, material, Pose())
        other = marble("other", RADIUS, material, Pose((2 * RADIUS + 0.05, 0.0, 0.0)), ratio)
        world = trial.world(scene(one, other, terrain=(), gravity=WEIGHTLESS))
        world.objects["one"].set_root_velocity(torch.tensor([[speed, 0.0, 0.0, 0.0, 0.0, 0.0]]))
        trial.step(world, trial.steps(0.2))
        truth = ((1 - restitution * ratio) / (1 + ratio) * speed, (1 + restitution) / (1 + ratio) * speed)
        got = [world.objects[name].root_velocity[0, 0].item() for name in ("one", "other")]
        errors += [abs(a - b) / speed for a, b in zip(got, truth, strict=True)]
        momenta.append(abs(got[0] + ratio * got[1] - speed) / speed)
    return {"speeds": max(errors), "momentum": max(momenta)}


SCENARIOS = (
    Scenario(
        name="bounce",
        group="Impact",
        question="Does what falls rise again to e^2 of its height, whatever its shape?",
        truth="h' = e^2 h",
        source="Goldsmith, Impact, 1960, section 1.2 (Newton's coefficient of restitution)",
        needs=(Capability.RESTITUTION,),
        judges=(Capability.RESTITUTION,),
        run=_bounce,
        metrics=(
            Metric(name="ball", unit="", tolerance=0.03, meaning="largest |h'/h - e^2| over drops and e, of a ball"),
            Metric(name="box", unit="", tolerance=0.03, meaning="the same of a box that falls flat on its face"),
        ),
    ),
    Scenario(
        name="bouncing_on",
        group="Impact",
        question="Does a ball bounce on, ever lower, until it lies?",
        truth="parabolas, each starting at e times the speed of the impact before",
        source="Stronge, Impact Mechanics, 2nd ed., section 1.4",
        needs=(Capability.RESTITUTION,),
        judges=(Capability.RESTITUTION,),
        run=_bouncing_on,
        metrics=(
            Metric(
                name="path",
                unit="",
                tolerance=0.08,
                meaning="largest distance from the height in closed form within 1.5 s, over the drop, e = 0.8",
            ),
        ),
    ),
    Scenario(
        name="collision_chain",
        group="Impact",
        question="Does a row of equal elastic balls hand an impact on, so that the last leaves with the first's speed?",
        truth="momentum and energy are kept; all rest but the last",
        source="Goldstein, Classical Mechanics, 3rd ed., section 3.11, for each pair in turn",
        needs=(Capability.RESTITUTION,),
        judges=(Capability.RESTITUTION,),
        run=_chain,
        metrics=(
            Metric(
                name="momentum",
                unit="",
                tolerance=1e-6,
                meaning="change of momentum over that of the first",
                looser_because="the best is at rounding error",
            ),
            Metric(
                name="energy",
                unit="",
                tolerance=0.01,
                meaning="relative change of kinetic energy after four impacts",
                looser_because="engines that resolve an impact exactly within a step err by rounding alone",
            ),
            Metric(
                name="last",
                unit="",
                tolerance=0.01,
                meaning="relative error of the last ball's speed",
                looser_because="as for the energy",
            ),
            Metric(
                name="others",
                unit="",
                tolerance=0.01,
                meaning="largest speed of another ball, over the first's at the beginning",
                looser_because="as for the energy",
            ),
        ),
    ),
    Scenario(
        name="unequal_collision",
        group="Impact",
        question="Do balls of unlike mass part with e times the speed at which they met?",
        truth="v1 = (m1 - e m2) v / (m1 + m2), v2 = (1 + e) m1 v / (m1 + m2), e = 0.5, m2 / m1 of 0.1, 3 and 30",
        source="Stronge, Impact Mechanics, 2nd ed., section 1.4",
        needs=(Capability.RESTITUTION,),
        judges=(Capability.RESTITUTION,),
        run=_unequal,
        metrics=(
            Metric(
                name="speeds",
                unit="",
                tolerance=0.01,
                meaning="largest error of a speed, over that of the first ball",
                looser_because="engines that resolve an impact exactly within a step err by rounding alone",
            ),
            Metric(
                name="momentum",
                unit="",
                tolerance=1e-6,
                meaning="change of momentum over that of the first",
                looser_because="the best is at rounding error",
            ),
        ),
    ),
)
