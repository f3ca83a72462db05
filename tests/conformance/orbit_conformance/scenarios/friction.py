"""Sliding and rolling under Coulomb friction."""

from __future__ import annotations

import math
from collections.abc import Mapping

import torch
from torch import Tensor

from orbit_conformance.bodies import (
    SMOOTH,
    SMOOTH_GROUND,
    G,
    marble,
    on_slope,
    positions,
    scene,
    slope,
    smooth_material,
    standing_solids,
    velocities,
)
from orbit_conformance.scenario import Metric, Scenario, Trial
from orbit_core.interfaces import Capability, World
from orbit_core.scene import PhysicsMaterial, Pose

FRICTIONS = (0.3, 0.8)
RADIUS = 0.05


def _downhill(angle: float) -> Tensor:
    return torch.tensor([math.cos(angle), 0.0, -math.sin(angle)])


def _solids_on_slope(trial: Trial, angle: float, material: PhysicsMaterial) -> World:
    solids = standing_solids(material, on_slope(angle, 0.0))
    return trial.world(scene(*solids, terrain=(slope(angle, SMOOTH),)))


def _stick_and_slip(trial: Trial) -> Mapping[str, float]:
    creep, friction = [], []
    for mu in FRICTIONS:
        # 5 % below the angle of friction: a true law of friction holds without a margin for softness.
        angle = math.atan(0.95 * mu)
        held = _solids_on_slope(trial, angle, smooth_material(mu))
        # Contacts sink in first; only the motion after that is creep.
        trial.step(held, trial.steps(0.2))
        before = positions(held)
        trial.step(held, trial.steps(0.2))
        creep.append((positions(held) - before).norm(dim=-1).max() / 0.2)

        # 20 % beyond the angle of friction: steep enough to slip at once, and too flat to lose contact.
        angle = math.atan(1.2 * mu)
        slipping = _solids_on_slope(trial, angle, smooth_material(mu))
        trial.step(slipping, trial.steps(0.1))
        # The first tenth of a second, in which contacts settle, is left out of the acceleration.
        slow = velocities(slipping)[..., :3] @ _downhill(angle)
        trial.step(slipping, trial.steps(0.3))
        acceleration = (velocities(slipping)[..., :3] @ _downhill(angle) - slow) / 0.3
        felt = (G * math.sin(angle) - acceleration) / (G * math.cos(angle))
        friction.append((felt / mu - 1).abs().max())
    return {"creep": float(max(creep)), "friction": float(max(friction))}


def _stopping_distance(trial: Trial) -> Mapping[str, float]:
    errors, turns = [], []
    speed = 2.0
    # A pyramidal cone is right along its axes and wrong on its diagonals, so that one heading would hide it.
    headings = torch.tensor([0.0, math.pi / 8, math.pi / 4])
    for mu in FRICTIONS:
        world = trial.world(scene(*standing_solids(smooth_material(mu)), terrain=SMOOTH_GROUND), len(headings))
        trial.step(world, trial.steps(0.1))
        velocity = torch.zeros(len(headings), 6)
        velocity[:, 0], velocity[:, 1] = speed * headings.cos(), speed * headings.sin()
        before = positions(world)
        for thing in world.objects.values():
            thing.set_root_velocity(velocity)
        truth = speed**2 / (2 * mu * G)
        # A tenth of a second more than the true time, so that slow engines stop as well.
        trial.step(world, trial.steps(speed / (mu * G) + 0.1))
        slid = (positions(world) - before).norm(dim=-1)
        errors.append((slid / truth - 1).abs().max())
        # Friction through the centre turns nothing: each turn is an error of the contact's load distribution.
        w, z = torch.stack([thing.root_pose[:, (3, 6)] for thing in world.objects.values()]).unbind(-1)
        turns.append((2 * torch.atan2(z, w)).abs().max())
    return {"distance": float(max(errors)), "turn": float(max(turns))}


def _static_above_dynamic(trial: Trial) -> Mapping[str, float]:
    # The slope is between both coefficients: at rest static friction holds, in motion dynamic friction lets go.
    angle, static, dynamic = math.atan(0.45), 0.6, 0.3
    world = trial.world(
        scene(
            *standing_solids(PhysicsMaterial(static, dynamic, 0.0, 0.0), on_slope(angle, 0.0)),
            terrain=(slope(angle, SMOOTH),),
        ),
        2,
    )
    trial.step(world, trial.steps(0.2))
    before, start = positions(world)[0], 0.5
    # Environment 1 is pushed off, environment 0 stays at rest: the same slope shows both coefficients.
    push = torch.cat((start * _downhill(angle), torch.zeros(3)))[None]
    for thing in world.objects.values():
        thing.set_root_velocity(push, torch.tensor([1]))
    trial.step(world, trial.steps(0.5))
    speed = velocities(world)[1, :, :3] @ _downhill(angle)
    felt = (G * math.sin(angle) - (speed - start) / 0.5) / (G * math.cos(angle))
    moved = (positions(world)[0] - before).norm(dim=-1).max()
    return {"slip": float(moved), "friction": float((felt / dynamic - 1).abs().max())}


def _rolling_down(trial: Trial, mu: float, tangent: float) -> tuple[float, float]:
    """Acceleration down the slope of a ball that starts at rest, and of its spin times the radius."""
    angle = math.atan(tangent)
    ball = marble("marble", RADIUS, smooth_material(mu), on_slope(angle, RADIUS))
    world = trial.world(scene(ball, terrain=(slope(angle, SMOOTH),)))
    trial.step(world, trial.steps(0.1))
    before = world.objects["marble"].root_velocity[0].clone()
    trial.step(world, trial.steps(0.4))
    change = (world.objects["marble"].root_velocity[0] - before) / 0.4
    return float(change[:3] @ _downhill(angle)), float(change[4]) * RADIUS


def _ball_on_slope(trial: Trial) -> Mapping[str, float]:
    mu = 0.3
    # A ball rolls without slip up to a slope of 7/2 of its friction.
    limit = 3.5 * mu
    rolling, slipping = [], []
    for share in (0.3, 0.6, 0.9):
        truth = 5 / 7 * G * math.sin(math.atan(share * limit))
        rolling += [abs(value / truth - 1) for value in _rolling_down(trial, mu, share * limit)]
    for share in (1.2, 1.6):
        angle = math.atan(share * limit)
        downhill, spin = _rolling_down(trial, mu, share * limit)
        slipping.append(abs(downhill / (G * (math.sin(angle) - mu * math.cos(angle))) - 1))
        slipping.append(abs(spin / (2.5 * mu * G * math.cos(angle)) - 1))
    return {"rolling": max(rolling), "slipping": max(slipping)}


def _sliding_to_rolling(trial: Trial) -> Mapping[str, float]:
    mu, speed = 0.3, 2.0
    ball = marble("marble", RADIUS, smooth_material(mu), Pose((0.0, 0.0, RADIUS)))
    world = trial.world(scene(ball, terrain=SMOOTH_GROUND))
    body = world.objects["marble"]
    trial.step(world, trial.steps(0.1))
    body.set_root_velocity(torch.tensor([[speed, 0.0, 0.0, 0.0, 0.0, 0.0]]))
    times, speeds, spins = [0.0], [speed], [0.0]
    for _ in range(20):
        trial.step(world, trial.steps(0.02))
        times.append(times[-1] + 0.02)
        speeds.append(body.root_velocity[0, 0].item())
        spins.append(body.root_velocity[0, 4].item() * RADIUS)
    time = torch.tensor(times)
    # Friction slows the ball until its spin fits its speed, which is then 5/7 of the first.
    truth = torch.clamp(speed - mu * G * time, min=5 / 7 * speed)
    trial.trace("speed", "m/s", times, speeds, truth.tolist())
    end = 5 / 7 * speed
    return {
        "end": max(abs(speeds[-1] / end - 1), abs(spins[-1] / end - 1)),
        "way": float((torch.tensor(speeds) - truth).abs().max()),
    }


def _torsional(trial: Trial) -> Mapping[str, float]:
    friction, spin, duration = 0.005, 40.0, 0.4
    material = PhysicsMaterial(0.5, 0.5, friction, 0.0)
    world = trial.world(scene(marble("marble", RADIUS, material, Pose((0.0, 0.0, RADIUS))), terrain=SMOOTH_GROUND))
    body = world.objects["marble"]
    trial.step(world, trial.steps(0.1))
    body.set_root_velocity(torch.tensor([[0.0, 0.0, 0.0, 0.0, 0.0, spin]]))
    trial.step(world, trial.steps(duration))
    # The torque is friction times the weight, on the inertia 2/5 m r^2 of a ball.
    lost = spin - body.root_velocity[0, 5].item()
    return {"deceleration": abs(lost / (friction * G / (0.4 * RADIUS**2) * duration) - 1)}


def _rolling_resistance(trial: Trial) -> Mapping[str, float]:
    friction, speed, duration = 0.001, 1.0, 1.0
    material = PhysicsMaterial(0.5, 0.5, 0.0, friction)
    world = trial.world(scene(marble("marble", RADIUS, material, Pose((0.0, 0.0, RADIUS))), terrain=SMOOTH_GROUND))
    body = world.objects["marble"]
    trial.step(world, trial.steps(0.1))
    # The ball starts in pure rolling, so that no sliding friction adds to the loss.
    body.set_root_velocity(torch.tensor([[speed, 0.0, 0.0, 0.0, speed / RADIUS, 0.0]]))
    trial.step(world, trial.steps(duration))
    lost = speed - body.root_velocity[0, 0].item()
    return {"deceleration": abs(lost / (5 / 7 * friction * G / RADIUS * duration) - 1)}


_KNOWN_TO = "coefficients of friction are hardly ever known as well; the best engines err by rounding alone"
_COULOMB = "Goldstein, Classical Mechanics, 3rd ed., section 1.5; Coulomb's law of dry friction"
_ROLLING = "Taylor, Classical Mechanics, section 10.4 and problem 10.27: a ball that rolls, or slips, under friction"

SCENARIOS = (
    Scenario(
        name="stick_and_slip",
        group="Friction",
        question="Do things of every shape hold on a slope up to the angle of friction, and slide beyond it?",
        truth="at rest at tan(angle) = 0.95 mu; acceleration g (sin - mu cos) at 1.2 mu; mu of 0.3 and 0.8",
        source=_COULOMB,
        judges=(Capability.FRICTION,),
        run=_stick_and_slip,
        metrics=(
            Metric(name="creep", unit="m/s", tolerance=1e-3, meaning="largest speed of a thing that should hold"),
            Metric(
                name="friction",
                unit="",
                tolerance=0.01,
                meaning="largest relative error of the coefficient felt: (g sin - a) / (g cos) over mu",
                looser_because=_KNOWN_TO,
            ),
        ),
    ),
    Scenario(
        name="stopping_distance",
        group="Friction",
        question="How far do things of every shape slide that were pushed off, in three directions?",
        truth="v^2 / (2 mu g), v = 2 m/s, mu of 0.3 and 0.8; no turn: the load moves straight ahead",
        source=_COULOMB,
        judges=(Capability.FRICTION,),
        run=_stopping_distance,
        metrics=(
            Metric(
                name="distance",
                unit="",
                tolerance=0.04,
                meaning="largest relative error of the distance",
                looser_because="integrators of first order err by mu g dt / v, 2 % here",
            ),
            Metric(
                name="turn",
                unit="rad",
                tolerance=0.02,
                meaning="largest angle about the vertical by which one turns",
                looser_because="a degree is not seen; the best engines err by 2e-4",
            ),
        ),
    ),
    Scenario(
        name="static_above_dynamic",
        group="Friction",
        question="Does a thing at rest hold where static friction would, and the same thing in motion slide on?",
        truth="at rest, and g (sin - mu cos): tan(angle) = 0.45 between 0.6 (static) and 0.3 (dynamic)",
        source=_COULOMB,
        needs=(Capability.STATIC_FRICTION,),
        judges=(Capability.STATIC_FRICTION,),
        run=_static_above_dynamic,
        metrics=(
            Metric(name="slip", unit="m", tolerance=1e-3, meaning="largest way, in 0.5 s, of a thing left at rest"),
            Metric(
                name="friction",
                unit="",
                tolerance=0.01,
                meaning="largest relative error of the coefficient felt in motion",
                looser_because=_KNOWN_TO,
            ),
        ),
    ),
    Scenario(
        name="ball_on_slope",
        group="Friction",
        question="Does a ball roll down a slope below tan(angle) = 7/2 mu, and slip beyond?",
        truth="rolling a = r alpha = 5/7 g sin; slipping a = g (sin - mu cos), r alpha = 5/2 mu g cos; mu = 0.3",
        source=_ROLLING,
        judges=(Capability.FRICTION,),
        run=_ball_on_slope,
        metrics=(
            Metric(
                name="rolling",
                unit="",
                tolerance=5e-3,
                meaning="largest relative error of a and r alpha at 0.3, 0.6 and 0.9 of the limit",
                looser_because=_KNOWN_TO,
            ),
            Metric(
                name="slipping",
                unit="",
                tolerance=5e-3,
                meaning="the same at 1.2 and 1.6 times the limit",
                looser_because=_KNOWN_TO,
            ),
        ),
    ),
    Scenario(
        name="sliding_to_rolling",
        group="Friction",
        question="Does a ball that is set sliding come to roll at 5/7 of its speed?",
        truth="v = v0 - mu g t until it is 5/7 v0, then constant; v0 = 2 m/s, mu = 0.3",
        source=_ROLLING,
        judges=(Capability.FRICTION,),
        run=_sliding_to_rolling,
        metrics=(
            Metric(
                name="end",
                unit="",
                tolerance=5e-3,
                meaning="relative error of the speed, and of the spin, at the end",
                looser_because=_KNOWN_TO,
            ),
            Metric(
                name="way",
                unit="m/s",
                tolerance=0.01,
                meaning="largest error of the speed on the way",
                looser_because=_KNOWN_TO,
            ),
        ),
    ),
    Scenario(
        name="torsional_friction",
        group="Friction",
        question="Does torsional friction slow a ball that spins on the spot?",
        truth="d(omega)/dt = -mu m g / I, mu = 5 mm",
        source="Johnson, Contact Mechanics, section 8.4 (spin), with the law of PhysicsMaterial",
        needs=(Capability.TORSIONAL_FRICTION,),
        judges=(Capability.TORSIONAL_FRICTION,),
        run=_torsional,
        metrics=(
            Metric(name="deceleration", unit="", tolerance=1.5e-3, meaning="relative error", looser_because=_KNOWN_TO),
        ),
    ),
    Scenario(
        name="rolling_resistance",
        group="Friction",
        question="Does rolling friction slow a ball that rolls?",
        truth="dv/dt = -5/7 mu g / r, mu = 1 mm",
        source="Johnson, Contact Mechanics, section 8.3 (rolling), with the law of PhysicsMaterial",
        needs=(Capability.ROLLING_FRICTION,),
        judges=(Capability.ROLLING_FRICTION,),
        run=_rolling_resistance,
        metrics=(
            Metric(name="deceleration", unit="", tolerance=0.01, meaning="relative error", looser_because=_KNOWN_TO),
        ),
    ),
)
