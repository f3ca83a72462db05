"""Scenarios of impacts: bounces, collisions, friction in an impact, and a row of dominoes."""

from __future__ import annotations

import math
from collections.abc import Mapping

import torch
from torch import Tensor

from orbit_assets.objects import box
from orbit_conformance.bodies import (
    RADIUS,
    SMOOTH,
    SMOOTH_GROUND,
    WEIGHTLESS,
    G,
    block,
    marble,
    on_slope,
    scene,
    slope,
    smooth_material,
)
from orbit_conformance.scenario import Metric, Scenario, Trial
from orbit_core.dynamics.transforms import quat_rotate
from orbit_core.interfaces import Capability, Object, World
from orbit_core.scene import ObjectSpec, Pose

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
    # Until the last has bounced, and before the first falls again.
    trial.step(world, trial.steps(math.sqrt(2 * max(_DROPS) / G) + 0.08))
    # Height and speed in flight give the height of the rebound without waiting for it.
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
    # Infinitely many bounces end in finite time; below 1 mm/s they cannot be seen.
    while speed > 1e-3:
        speed *= restitution
        flight = 2 * speed / G
        if time < flight:
            return speed * time - 0.5 * G * time**2
        time -= flight
    return 0.0


def _chain(trial: Trial) -> Mapping[str, float]:
    # A gap between the balls makes the impacts follow one another, which decides the outcome.
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
    # Impacts at several instants within a step: an engine that is right at one may be wrong at another.
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
    # The landing's impulse m g t takes the same friction along as the weight does over that time.
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


_COUNT = 8
# Thickness, width and height in metres.
_SIZE = (0.03, 0.1, 0.2)
# Distance in metres from middle to middle.
_APART = 0.1
# Angular velocity in rad/s of the first domino about its lower edge.
_PUSH = 3.0
_TILTED = math.radians(10.0)
# Speed in m/s from the fourth piece to the last: three engines at steps of 0.25 ms come to 1.268, 1.274 and 1.276.
_SPEED = 1.275


def _dominoes(trial: Trial) -> Mapping[str, float]:
    pieces = [
        box(f"piece{number}", _SIZE, mass=0.5, material=smooth_material(0.5), pose=Pose((_APART * number, 0.0, 0.1)))
        for number in range(_COUNT)
    ]
    world = trial.world(scene(*pieces, terrain=SMOOTH_GROUND))
    trial.step(world, trial.steps(0.1))
    # About the edge at (thickness / 2, -height / 2) from the middle.
    speed = [_PUSH * _SIZE[2] / 2, 0.0, _PUSH * _SIZE[0] / 2, 0.0, _PUSH, 0.0]
    world.objects["piece0"].set_root_velocity(torch.tensor([speed], device=world.device))
    tipped = torch.full((_COUNT,), math.nan, dtype=torch.float64)
    before = torch.zeros(_COUNT, dtype=torch.float64)
    up = torch.tensor([0.0, 0.0, 1.0], dtype=torch.float64).expand(_COUNT, 3)
    for time in trial.advance(world, 0.9):
        poses = torch.cat([thing.root_pose for thing in world.objects.values()]).double().cpu()
        top = quat_rotate(poses[:, 3:], up)
        tilt = torch.atan2(top[:, 0], top[:, 2])
        passed = (before < _TILTED) & (tilt >= _TILTED) & tipped.isnan()
        at = time - trial.time_step * (tilt - _TILTED) / (tilt - before)
        tipped = torch.where(passed, at, tipped)
        before = tilt
    numbers = list(range(_COUNT))
    steady = [float(tipped[3]) + (number - 3) * _APART / _SPEED for number in numbers]
    trial.trace("time at which a piece tips, over its number", "s", numbers, tipped.tolist(), steady)
    # A piece that never tips leaves NaN, which compares false: it counts as standing.
    stages = tipped.diff()
    return {
        "standing": float((~(stages > 0)).sum()),
        # The first pieces still gain speed from the push.
        "speed": abs(float((_COUNT - 4) * _APART / (tipped[-1] - tipped[3])) / _SPEED - 1),
    }


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
    Scenario(
        name="dominoes",
        group="Impact",
        question="Does a row of dominoes fall, one after the other, as fast at any time step?",
        truth="a wave of 1.275 m/s, to which three engines with nothing in common converge within 0.6 % at 0.25 ms",
        source="convergence; van Leeuwen, American Journal of Physics 78, 2010, p. 721 (a wave of constant speed)",
        run=_dominoes,
        metrics=(
            Metric(name="standing", unit="", tolerance=0.0, meaning="pieces that did not tip after the one before"),
            Metric(
                name="speed",
                unit="",
                tolerance=0.02,
                meaning="relative error of the wave's speed between the fourth piece and the last",
                looser_because="the reference is known to half a per cent",
            ),
        ),
    ),
)
