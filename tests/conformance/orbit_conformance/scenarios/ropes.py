"""Ropes that hang, swing and pull."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from orbit_assets.deformables import line
from orbit_conformance.bodies import WEIGHTLESS, G, body
from orbit_conformance.scenario import FIRST_ORDER, Metric, Scenario, Trial
from orbit_conformance.slender import BESSEL_ZERO, catenary, chain_period, loaded_chain_period
from orbit_core.interfaces import Capability, World
from orbit_core.scene import Articulation, Attachment, Link, ObjectSpec, Pose, Rope, Scene, Shape, Sphere

GROUP = "Matter"
TIME_STEPS = (0.005, 0.0025, 0.00125)
# Turns x down.
HANGING = (math.sqrt(0.5), 0.0, math.sqrt(0.5), 0.0)
# A reason for a :attr:`Metric.looser_because`.
ASKED = "what tasks with cloth and rope ask for; the best holds together exactly what it holds"
# Of links that carry cloth or rope.
WEIGHT_FELT = Metric(
    name="force", unit="", tolerance=0.02, meaning="error of the mean force over the weight", looser_because=ASKED
)
_LATE = "a body that another solver moves feels its rope one physics step late, which gives to slow swings or takes"
# Metres, or radians times metres, of swings that are small.
SMALL = 0.01


def hanging_rope(
    length: float,
    count: int,
    held: tuple[Attachment, ...],
    density: float = 0.1,
    bending_stiffness: float = 0.0,
    damping: float = 0.0,
) -> Rope:
    """A rope straight down from 1 m above the origin."""
    points = line(length, count) + np.array([0.5 * length, 0.0, 0.0])
    pose, stiffness = Pose((0.0, 0.0, 1.0), HANGING), bending_stiffness
    return Rope("rope", points, density, pose, bending_stiffness=stiffness, damping=damping, attachments=held)


def bob(mass: float, position: tuple[float, float, float], fixed: bool = False) -> ObjectSpec:
    """A body without shapes."""
    link = body("bob", mass, inertia=0.01 * mass)
    return ObjectSpec(name="bob", articulation=Articulation("bob", (link,)), pose=Pose(position), fixed_base=fixed)


def period_of(times: Sequence[float], positions: Sequence[float]) -> float:
    """Seconds of a swing about zero, from its first to its last crossing; infinite without two."""
    signs = np.sign(positions)
    before = np.flatnonzero(signs[:-1] != signs[1:])
    if len(before) < 2:
        return math.inf
    # The mean over all swings between the first and the last crossing averages out the time step's grid.
    moments = [_crossing(times[k : k + 2], positions[k : k + 2]) for k in (before[0], before[-1])]
    return 2.0 * (moments[1] - moments[0]) / (len(before) - 1)


def _crossing(times: Sequence[float], positions: Sequence[float]) -> float:
    share = positions[0] / (positions[0] - positions[1])
    return times[0] + share * (times[1] - times[0])


def particle_masses(rope: Rope) -> Tensor:
    """(P,) kg: each edge's mass at its two ends."""
    edges = np.linalg.norm(np.diff(rope.rest_positions, axis=0), axis=1) * rope.linear_density
    return torch.as_tensor(0.5 * (np.append(edges, 0.0) + np.append(0.0, edges)), dtype=torch.float32)


# The scenarios -------------------------------------------------------------------------------------------------------


def _catenary(trial: Trial) -> Mapping[str, float]:
    length, span, count = 0.6, 0.4, 51
    along = np.linspace(0.0, length, count)
    # The rope starts as two straight halves of the right length, close to the catenary without being it.
    fall = np.minimum(along, length - along) * math.sqrt(1.0 - (span / length) ** 2)
    points = np.stack((along * span / length - 0.5 * span, 0.0 * along, -fall), axis=-1)
    held = (Attachment((0, count - 1)),)
    # Stiff along and limp across, as the catenary assumes; damping brings it to rest in the time given.
    axial, bending, still = 5000.0, 1e-6, 3.0
    rope = Rope("rope", points, 0.1, Pose((0.0, 0.0, 1.0)), 0.005, axial, bending, still, attachments=held)
    world = trial.world(Scene(deformables=(rope,), terrain=()))
    trial.step(world, trial.steps(4.0))
    x, _, z = (world.deformables["rope"].positions[0].cpu() - torch.tensor([0.0, 0.0, 1.0])).double().numpy().T
    a = catenary(length, span)
    truth = a * (np.cosh(x / a) - math.cosh(span / (2 * a)))
    return {"shape": float(np.abs(z - truth).max())}


def _swing(trial: Trial) -> Mapping[str, float]:
    length, count = 0.5, 41
    world = trial.world(Scene(deformables=(hanging_rope(length, count, (Attachment((0,)),)),), terrain=()))
    rope = world.deformables["rope"]
    depths = torch.linspace(1.0, 0.0, count, dtype=torch.float64)
    start = rope.positions.clone()
    start[0, :, 1] += SMALL * torch.special.bessel_j0(BESSEL_ZERO * depths.sqrt()).float().to(start.device)
    rope.set_state(start)
    times, tips = _watched(trial, world, 3.0, lambda: rope.positions[0, -1, 1])
    truth = chain_period(length, G)
    trial.trace("tip", "m", times, tips, [SMALL * math.cos(2 * math.pi * time / truth) for time in times])
    return {"period": abs(period_of(times, tips) / truth - 1.0), "amplitude": _drift(tips, SMALL)}


def _watched(
    trial: Trial, world: World, seconds: float, watch: Callable[[], Tensor | float]
) -> tuple[list[float], list[float]]:
    pairs = [(time, float(watch())) for time in trial.advance(world, seconds)]
    times, values = zip(*pairs, strict=True)
    return list(times), list(values)


def _drift(positions: Sequence[float], amplitude: float) -> float:
    """Return the relative difference of the last third's greatest deflection from the amplitude."""
    last = np.abs(positions[-len(positions) // 3 :])
    return abs(float(last.max()) / amplitude - 1.0)


def _loaded(trial: Trial) -> Mapping[str, float]:
    length, load = 0.5, 0.2
    held = (Attachment((0,)), Attachment((20,), "bob", "bob"))
    rope = hanging_rope(length, 21, held)
    weight = bob(load, (0.0, 0.0, 1.0 - length))
    world = trial.world(Scene(objects=(weight,), deformables=(rope,), terrain=()))
    truth = loaded_chain_period(length, rope.mass, load, G)
    speed = SMALL * 2 * math.pi / truth
    world.objects["bob"].set_root_velocity(torch.tensor([[0.0, speed, 0.0, 0.0, 0.0, 0.0]], device=world.device))
    times, places = _watched(trial, world, 4.0, lambda: world.objects["bob"].root_pose[0, 1])
    trial.trace("load", "m", times, places, [SMALL * math.sin(2 * math.pi * time / truth) for time in times])
    third = len(places) // 3
    first = float(np.abs(places[:third]).max())
    return {"period": abs(period_of(times, places) / truth - 1.0), "amplitude": _drift(places, first)}


def _pulls(trial: Trial) -> Mapping[str, float]:
    rope = hanging_rope(0.2, 11, (Attachment((0,), "bob", "bob"),), 0.5, 1e-4, 1.0)
    world = trial.world(Scene(objects=(bob(0.5, (0.0, 0.0, 1.0), fixed=True),), deformables=(rope,), terrain=()))
    return {"force": weight_error(trial, world, "rope", [("bob", "bob")])}


def weight_error(trial: Trial, world: World, name: str, links: Sequence[tuple[str, str]]) -> float:
    """Return the relative error of the force that bears the matter's weight, over half a second."""
    matter = world.deformables[name]
    trial.step(world, trial.steps(1.0))
    felt = torch.zeros(3, device=world.device)
    count = trial.steps(0.5)
    for _ in range(count):
        trial.step(world)
        felt += sum(matter.contact_force(*link)[0] for link in links) / count
    weight = torch.tensor([0.0, 0.0, -G * matter.spec.mass])  # pyright: ignore[reportAttributeAccessIssue]
    return float((felt.cpu() - weight).norm() / weight.norm())


def _towed(trial: Trial) -> Mapping[str, float]:
    points = line(0.2, 11) + np.array([0.1, 0.0, 0.0])
    rope = Rope("rope", points, 1.0, attachments=(Attachment((0,), "bob", "bob"),), damping=0.0)
    mass, kick = 0.5, -0.5
    world = trial.world(
        Scene(objects=(bob(mass, (0.0, 0.0, 0.0)),), deformables=(rope,), terrain=(), gravity=WEIGHTLESS)
    )
    world.objects["bob"].set_root_velocity(torch.tensor([[kick, 0.0, 0.0, 0.0, 0.0, 0.0]], device=world.device))
    weights = particle_masses(rope).to(world.device)

    def momentum() -> float:
        carried = weights @ world.deformables["rope"].velocities[0, :, 0]
        return float(mass * world.objects["bob"].root_velocity[0, 0] + carried)

    times, measured = _watched(trial, world, 0.5, momentum)
    trial.trace("momentum", "kg m/s", times, measured, [mass * kick] * len(times))
    settled = measured[len(measured) // 2 :]
    return {"momentum": abs(float(np.mean(settled)) / (mass * kick) - 1.0)}


@dataclass(frozen=True)
class Bob:
    """A ball that is let go at rest on a straight rope."""

    mass: float
    """kg; its rope weighs 25 g."""
    angle: float
    """rad from straight down."""
    collides: bool = False
    """True to let bob and rope touch."""


_TAUT = (
    Bob(0.005, 0.3, collides=True),
    Bob(0.005, 1.0),
    Bob(0.05, 1.0),
    Bob(0.5, 0.3, collides=True),
    Bob(0.5, 1.3),
    Bob(2.0, 1.0, collides=True),
    Bob(2.0, 1.57),
)
_FOLDING = (Bob(0.005, 1.57), Bob(0.05, 1.57), Bob(0.5, 1.57))
_ROPE_LENGTH, _ROPE_COUNT, _ROPE_STIFFNESS = 0.5, 26, 1e5


def _bobs(trial: Trial) -> Mapping[str, float]:
    changes, longest = _swung(trial, (*_TAUT, *_FOLDING))
    taut, folding = changes[:, : len(_TAUT)], changes[-5:, len(_TAUT) :]
    return {
        "energy": float(taut.abs().max()),
        "length": float(longest.max()),
        "folding": float(folding.mean(0).abs().max()),
    }


def _swung(trial: Trial, bobs: Sequence[Bob]) -> tuple[Tensor, Tensor]:
    """Let bobs go, next to each other, for 3 s.

    Returns:
        (30, B) relative change of the energy of each bob and its rope, mean of each tenth of a second; and (B,) by what
        part of the rope's length a bob was further from its anchor than that, at most.
    """
    ropes = tuple(_rope_of(bob, number) for number, bob in enumerate(bobs))
    balls = tuple(_ball_of(bob, number) for number, bob in enumerate(bobs))
    world = trial.world(Scene(objects=balls, deformables=ropes, terrain=()))
    objects, bodies = [world.objects[ball.name] for ball in balls], [world.deformables[rope.name] for rope in ropes]
    states: list[tuple[Tensor, ...]] = []
    for _ in trial.advance(world, 3.0):
        ends = [torch.cat((thing.root_pose[0, :3], thing.root_velocity[0, :3])) for thing in objects]
        along = [torch.cat((body.positions[0], body.velocities[0]), -1) for body in bodies]
        states.append((torch.stack(ends), torch.stack(along)))
    ends, along = (torch.stack(of).double().cpu() for of in zip(*states, strict=True))
    # Engines step velocities before positions: at a position, the velocity is the mean of that step's and the next's.
    places, v, along = ends[:-1, :, :3], 0.5 * (ends[:-1, :, 3:] + ends[1:, :, 3:]), along[:-1]
    v[0] = ends[0, :, 3:]
    mass = torch.tensor([bob.mass for bob in bobs], dtype=torch.float64)
    energy = 0.5 * mass * v.square().sum(-1) + G * mass * (places[..., 2] - 1.0) + _rope_energy(along, ropes[0])
    lowest = -G * _ROPE_LENGTH * (mass + 0.5 * ropes[0].mass)
    anchors = torch.tensor([rope.pose.position for rope in ropes], dtype=torch.float64)
    apart = (places - anchors).norm(dim=-1).amax(0)
    change = (energy[1:] - energy[0]) / (energy[0] - lowest)
    return torch.stack([part.mean(0) for part in change.tensor_split(30)]), apart / _ROPE_LENGTH - 1.0


def _rope_of(bob: Bob, number: int) -> Rope:
    down = np.array([math.sin(bob.angle), 0.0, -math.cos(bob.angle)])
    points = np.outer(np.linspace(0.0, _ROPE_LENGTH, _ROPE_COUNT), down)
    name, held = f"bob_{number}", Attachment((0,))
    return Rope(
        f"rope_{number}", points, 0.05, Pose((0.0, 0.2 * number, 1.0)), axial_stiffness=_ROPE_STIFFNESS,
        bending_stiffness=0.0, damping=0.0, attachments=(held, Attachment((_ROPE_COUNT - 1,), name, name)),
    )  # fmt: skip


def _ball_of(bob: Bob, number: int) -> ObjectSpec:
    rope, name, radius = _rope_of(bob, number), f"bob_{number}", 0.03
    shapes = (Shape(Sphere(radius)),) if bob.collides else ()
    link = Link(name, bob.mass, (0.0, 0.0, 0.0), np.eye(3) * (0.4 * bob.mass * radius**2), shapes)
    end = rope.pose.transform(rope.rest_positions[-1:])[0]
    return ObjectSpec(name=name, articulation=Articulation(name, (link,)), pose=Pose(tuple(end.tolist())))


def _rope_energy(states: Tensor, rope: Rope) -> Tensor:
    """Joules (T, B) of motion, of height below the anchors and of stretch, of positions and velocities (T, B, P, 6)."""
    x, v, rest = states[..., :3], states[..., 3:], _ROPE_LENGTH / (_ROPE_COUNT - 1)
    masses = particle_masses(rope).double()
    strain = x.diff(dim=-2).norm(dim=-1) / rest - 1.0
    moving = (0.5 * v.square().sum(-1) + G * (x[..., 2] - 1.0)) @ masses
    return moving + 0.5 * _ROPE_STIFFNESS * rest * strain.square().sum(-1)


SCENARIOS = (
    Scenario(
        name="rope_catenary",
        group=GROUP,
        question="Does a rope of 0.6 m between two points 0.4 m apart hang in a catenary?",
        truth="z = a cosh(x / a), 2 a sinh(span / 2 a) = length",
        source="Routh, A Treatise on Analytical Statics, vol. I, section 443",
        needs=(Capability.ROPES,),
        judges=(Capability.ROPES,),
        time_steps=TIME_STEPS,
        run=_catenary,
        metrics=(
            Metric(
                name="shape",
                unit="m",
                tolerance=1e-3,
                meaning="largest distance of a particle from it",
                looser_because=ASKED,
            ),
        ),
    ),
    Scenario(
        name="rope_swing",
        group=GROUP,
        question="Does a hanging rope swing in the period of a chain?",
        truth="4 pi sqrt(L / g) / 2.405, the first mode, from J0(2.405 sqrt(z / L))",
        source="Lamb, Dynamics, 1914, section 46; the zero of J0: Abramowitz and Stegun, table 9.5",
        needs=(Capability.ROPES,),
        judges=(Capability.ROPES,),
        time_steps=TIME_STEPS,
        run=_swing,
        metrics=(
            Metric(name="period", unit="", tolerance=4e-4, meaning="relative error of the mean period over 3 s"),
            Metric(
                name="amplitude",
                unit="",
                tolerance=0.1,
                meaning="relative change of the amplitude over 3 s",
                looser_because=FIRST_ORDER,
            ),
        ),
    ),
    Scenario(
        name="rope_pendulum",
        group=GROUP,
        question="Does a body at the end of a rope swing in the period of both?",
        truth="the least w with A J0(u) + B Y0(u) = 0 above and g y' = -w^2 y at the body, u = 2 w sqrt((z + c) / g)",
        source="Sujith and Hodges, Exact solution for the free vibration of a hanging cord with a tip mass, 1995",
        needs=(Capability.ROPES,),
        judges=(Capability.ROPES,),
        time_steps=TIME_STEPS,
        run=_loaded,
        metrics=(
            Metric(
                name="period",
                unit="",
                tolerance=8e-3,
                meaning="relative error of the mean period over 4 s",
                looser_because=_LATE,
            ),
            Metric(
                name="amplitude",
                unit="",
                tolerance=0.08,
                meaning="relative change of the amplitude over 4 s",
                looser_because=_LATE,
            ),
        ),
    ),
    Scenario(
        name="rope_weight",
        group=GROUP,
        question="Does a link feel the weight of a rope that hangs from it?",
        truth="m g down, and nothing across",
        source="equilibrium of forces",
        needs=(Capability.ROPES,),
        judges=(Capability.ROPES,),
        time_steps=TIME_STEPS,
        run=_pulls,
        metrics=(WEIGHT_FELT,),
    ),
    Scenario(
        name="rope_tow",
        group=GROUP,
        question="Does a body share its momentum with the rope that it pulls?",
        truth="the momentum of both is constant where nothing else acts",
        source="Goldstein, Poole and Safko, Classical Mechanics, 3rd ed., section 1.2",
        needs=(Capability.ROPES,),
        judges=(Capability.ROPES,),
        time_steps=TIME_STEPS,
        run=_towed,
        metrics=(
            Metric(
                name="momentum",
                unit="",
                tolerance=0.04,
                meaning="relative error of the mean momentum, 0.25 to 0.5 s",
                looser_because=_LATE,
            ),
        ),
    ),
    Scenario(
        name="rope_bobs",
        group=GROUP,
        question="Do bobs of 5 g to 2 kg keep their energy on 0.5 m of rope of 50 g/m, let go at 0.3 to 1.57 rad?",
        truth="the energy of motion, height and stretch of a bob and its rope is constant",
        source="Goldstein, Poole and Safko, Classical Mechanics, 3rd ed., section 1.2",
        needs=(Capability.ROPES,),
        judges=(Capability.ROPES,),
        time_steps=TIME_STEPS,
        substeps=(0.0005, 0.00025, 0.000125),
        run=_bobs,
        metrics=(
            Metric(
                name="energy",
                unit="",
                tolerance=0.02,
                meaning="largest relative change of any energy in 3 s, mean of each 0.1 s, where ropes stay taut",
                looser_because=ASKED,
            ),
            Metric(
                name="length",
                unit="",
                tolerance=0.005,
                meaning="largest part of the rope's length by which any bob is too far from its anchor",
            ),
            Metric(
                name="folding",
                unit="",
                tolerance=0.02,
                meaning="largest relative change of the mean energy from 2.5 to 3 s, where ropes go slack and fold: "
                "5 to 500 g from 1.57 rad",
            ),
        ),
    ),
)
