"""Impacts with friction: what slides as it lands, and what rests although it would rebound."""

from __future__ import annotations

import math
from collections.abc import Mapping

import torch
from torch import Tensor

from orbit_assets.objects import box
from orbit_conformance.bodies import SMOOTH, WEIGHTLESS, G, on_slope, scene, slope
from orbit_conformance.contact import RADIUS, SMOOTH_GROUND, marble, smooth_material
from orbit_conformance.scenario import Metric, Scenario, Trial
from orbit_core.interfaces import Capability, Object, World
from orbit_core.scene import Pose

# m/s along the normal; each falls at three times within a step.
_SPEEDS, _PHASES = (1.0, 3.0), 3
_SLIPPERY, _ROUGH = 0.15, 1.0
_SLOPE = math.radians(15.0)


def _bouncing_pair(trial: Trial, friction: float, restitution: float) -> World:
    """A ball and a flat box without weight, 0.1 m over the ground and one step's way more, part by part."""
    material = smooth_material(friction, restitution)
    things = (
        marble("ball", RADIUS, material, Pose()),
        box("box", (0.3, 0.3, 2 * RADIUS), mass=1.0, material=material, pose=Pose((0.0, 2.0, 0.0))),
    )
    down = torch.tensor(_SPEEDS).repeat_interleave(_PHASES)
    world = trial.world(scene(*things, terrain=SMOOTH_GROUND, gravity=WEIGHTLESS), len(down))
    for thing in world.objects.values():
        pose, velocity = thing.root_pose.clone(), torch.zeros(len(down), 6, device=world.device)
        parts = torch.arange(_PHASES).repeat(len(_SPEEDS)) / _PHASES
        pose[:, 2] = RADIUS + 0.1 + (down * trial.time_step * parts).to(world.device)
        velocity[:, 0], velocity[:, 2] = 1.5 * down.to(world.device), -down.to(world.device)
        thing.set_root_pose(pose)
        thing.set_root_velocity(velocity)
    trial.step(world, trial.steps(0.1 / min(_SPEEDS) + 0.08))
    return world


def _impulses(thing: Object) -> tuple[Tensor, Tensor]:
    """Impulses (N,) along the normal and against the slip of a thing of 1 kg."""
    velocity, down = thing.root_velocity.cpu(), torch.tensor(_SPEEDS).repeat_interleave(_PHASES)
    return velocity[:, 2] + down, 1.5 * down - velocity[:, 0]


def _oblique(trial: Trial) -> Mapping[str, float]:
    errors: dict[str, list[Tensor]] = {"sliding": [], "spin": [], "rolling": [], "box": [], "rebound": []}
    for restitution in (0.0, 0.8):
        world = _bouncing_pair(trial, _SLIPPERY, restitution)
        ball = world.objects["ball"]
        for name, metric in (("ball", "sliding"), ("box", "box")):
            normal, tangential = _impulses(world.objects[name])
            errors[metric].append(tangential / (_SLIPPERY * normal) - 1)
            down = torch.tensor(_SPEEDS).repeat_interleave(_PHASES)
            errors["rebound"].append(normal / down - 1 - restitution)
        spin = 0.4 * RADIUS * ball.root_velocity[:, 4].cpu()
        errors["spin"].append(spin / (_SLIPPERY * _impulses(ball)[0]) - 1)
        ball = _bouncing_pair(trial, _ROUGH, restitution).objects["ball"]
        velocity, down = ball.root_velocity.cpu(), torch.tensor(_SPEEDS).repeat_interleave(_PHASES)
        errors["rolling"].append((1.5 * down - velocity[:, 0]) / (2 / 7 * 1.5 * down) - 1)
    return {name: float(torch.cat(values).abs().max()) for name, values in errors.items()}


def _landing(trial: Trial) -> Mapping[str, float]:
    friction, speed, heights = 0.5, 2.0, torch.tensor((0.05, 0.1, 0.2, 0.4, 0.45))
    flat = box("box", (0.3, 0.3, 0.03), mass=1.0, material=smooth_material(friction))
    world = trial.world(scene(flat, terrain=SMOOTH_GROUND), len(heights))
    body = world.objects["box"]
    pose, velocity = body.root_pose.clone(), torch.zeros(len(heights), 6, device=world.device)
    pose[:, 2], velocity[:, 0] = 0.015 + heights.to(world.device), speed
    body.set_root_pose(pose)
    body.set_root_velocity(velocity)
    trial.step(world, trial.steps(0.9))
    fall = (2 * heights / G).sqrt()
    after = (speed - friction * G * fall).clamp(min=0.0)
    way = speed * fall + after**2 / (2 * friction * G)
    return {"way": float(((body.root_pose - pose)[:, 0].cpu() / way - 1).abs().max())}


def _resting(trial: Trial) -> Mapping[str, float]:
    creep, stop = [], []
    friction, speed = 0.8, 2.0
    for restitution in (0.5, 0.8, 0.95):
        material = smooth_material(friction, restitution)
        held = box("box", (0.1, 0.1, 0.1), mass=1.0, material=material, pose=on_slope(_SLOPE, 0.05))
        world = trial.world(scene(held, terrain=(slope(_SLOPE, SMOOTH),)))
        trial.step(world, trial.steps(0.5))
        before = world.objects["box"].root_pose[:, :3].clone()
        trial.step(world, trial.steps(0.5))
        creep.append(float((world.objects["box"].root_pose[:, :3] - before).norm()) / 0.5)

        sliding = box("box", (0.2, 0.2, 0.05), mass=1.0, material=material, pose=Pose((0.0, 0.0, 0.025)))
        world = trial.world(scene(sliding, terrain=SMOOTH_GROUND))
        trial.step(world, trial.steps(0.1))
        body = world.objects["box"]
        before = body.root_pose[:, 0].clone()
        body.set_root_velocity(torch.tensor([[speed, 0.0, 0.0, 0.0, 0.0, 0.0]], device=world.device))
        trial.step(world, trial.steps(speed / (friction * G) + 0.4))
        way = float((body.root_pose[:, 0] - before)[0])
        stop.append(abs(way / (speed**2 / (2 * friction * G)) - 1))
    return {"creep": max(creep), "distance": max(stop)}


_FIRST_ORDER = "coefficients of friction are hardly ever known as well; the best engines err by 1e-3"
_COULOMB = "Stronge, Impact Mechanics, 2nd ed., sections 3.3 and 4.1: planar impact with Coulomb friction"

SCENARIOS = (
    Scenario(
        name="oblique_impact",
        group="Impact",
        question="Does what bounces take Coulomb's friction along, and no more than stops its slip?",
        truth="tangential impulse mu (1 + e) m v while it slides, 2/7 m u where it rolls; e of 0 and 0.8",
        source=_COULOMB,
        needs=(Capability.RESTITUTION,),
        judges=(Capability.FRICTION, Capability.RESTITUTION),
        run=_oblique,
        time_steps=(0.005, 0.0025),
        metrics=(
            Metric(
                name="sliding",
                unit="",
                tolerance=0.02,
                meaning="largest relative error of a sliding ball's tangential impulse, of mu times its normal one",
                looser_because=_FIRST_ORDER,
            ),
            Metric(
                name="spin",
                unit="",
                tolerance=0.02,
                meaning="the same of the spin that it takes on",
                looser_because=_FIRST_ORDER,
            ),
            Metric(
                name="rolling",
                unit="",
                tolerance=0.05,
                meaning="largest relative error of a ball's tangential impulse that rough ground stops from slipping",
                looser_because=_FIRST_ORDER,
            ),
            Metric(
                name="box",
                unit="",
                tolerance=0.02,
                meaning="as for the sliding ball, of a box that lands flat",
                looser_because=_FIRST_ORDER,
            ),
            Metric(
                name="rebound",
                unit="",
                tolerance=0.05,
                meaning="largest error of the speed of rebound over that of approach, of what slides",
                looser_because=_FIRST_ORDER,
            ),
        ),
    ),
    Scenario(
        name="sliding_landing",
        group="Impact",
        question="How far does a box slide that lands flat, with a speed along the ground?",
        truth="v t + u^2 / (2 mu g), u = v - mu sqrt(2 g h), v = 2 m/s, mu = 0.5, h from 0.05 to 0.45 m",
        source=_COULOMB,
        judges=(Capability.FRICTION,),
        run=_landing,
        metrics=(
            Metric(
                name="way",
                unit="",
                tolerance=0.05,
                meaning="largest relative error of the way until it rests",
                looser_because="integrators of first order err by a step's way, 2 % here",
            ),
        ),
    ),
    Scenario(
        name="resting_with_restitution",
        group="Friction",
        question="Does friction hold and stop a box in the same way where its material would rebound?",
        truth="at rest on a slope of 15 degrees; v^2 / (2 mu g), v = 2 m/s; mu = 0.8, e of 0.5, 0.8 and 0.95",
        source="Goldstein, Classical Mechanics, 3rd ed., section 1.5; Coulomb's law of dry friction",
        needs=(Capability.RESTITUTION,),
        judges=(Capability.FRICTION, Capability.RESTITUTION),
        run=_resting,
        metrics=(
            Metric(
                name="creep",
                unit="m/s",
                tolerance=1e-3,
                meaning="speed of a box that should hold",
                looser_because="a millimetre in a second is not seen; the best engines err by rounding alone",
            ),
            Metric(
                name="distance",
                unit="",
                tolerance=0.04,
                meaning="largest relative error of the distance until a sliding box rests",
                looser_because="integrators of first order err by mu g dt / v, 2 % here",
            ),
        ),
    ),
)
