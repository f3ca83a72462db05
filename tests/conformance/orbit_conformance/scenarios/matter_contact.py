"""Cloth and rope on solids: they slide, hang over an edge, are held by two fingers, and weigh on what bears them."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from orbit_assets.deformables import line, sheet
from orbit_assets.objects import cylinder
from orbit_conformance.bodies import G, cube, on_slope, slope
from orbit_conformance.scenario import Metric, Scenario, Trial
from orbit_conformance.scenarios.grasp import HALF, gripper
from orbit_conformance.scenarios.ropes import ASKED, GROUP, HANGING, TIME_STEPS, WEIGHT_FELT, weight_error
from orbit_conformance.slender import Edge
from orbit_core.interfaces import Capability, World
from orbit_core.scene import (
    Articulation,
    Attachment,
    Box,
    Cloth,
    Cylinder,
    Link,
    ObjectSpec,
    PhysicsMaterial,
    Pose,
    Rope,
    Scene,
    Shape,
)

FRICTION = 0.4
# Tangents of the slopes.
HOLDING, SLIDING = 0.38, 0.6
EDGE_FRICTION, RADIUS, LENGTH, SPACING = 0.3, 0.03, 0.4, 0.01
SHARES = (0.85, 0.95, 1.05, 1.3)
# Lengths that hang over the edge in each environment, as parts of the one at which it begins to slide.
_FIRST_TO_SLIDE = SHARES.index(1.05)
THICKNESS = 0.004


# A slope -------------------------------------------------------------------------------------------------------------


def _slope(trial: Trial) -> Mapping[str, float]:
    crept, _ = _slid(trial, HOLDING)
    _, acceleration = _slid(trial, SLIDING)
    angle = math.atan(SLIDING)
    truth = G * (math.sin(angle) - FRICTION * math.cos(angle))
    return {"creep": crept, "acceleration": abs(acceleration / truth - 1.0)}


def _slid(trial: Trial, tangent: float) -> tuple[float, float]:
    """Metres a second and m/s^2 of a cloth on a slope, over 0.4 s."""
    angle, duration = math.atan(tangent), 0.4
    ground = slope(angle, PhysicsMaterial(FRICTION, FRICTION))
    place = on_slope(angle, 0.5 * THICKNESS)
    cloth = Cloth("cloth", sheet((0.1, 0.1), (6, 6)), 0.2, place, friction=FRICTION, damping=0.0)
    world = trial.world(Scene(deformables=(cloth,), terrain=(ground,)))
    body = world.deformables["cloth"]
    trial.step(world, trial.steps(0.2))
    before, speed = body.positions[0].mean(0).clone(), body.velocities[0].mean(0).norm().clone()
    trial.step(world, trial.steps(duration))
    moved = float((body.positions[0].mean(0) - before).norm())
    return moved / duration, float(body.velocities[0].mean(0).norm() - speed) / duration


# An edge -------------------------------------------------------------------------------------------------------------


def _cloth_edge(trial: Trial) -> Mapping[str, float]:
    counts = (round(LENGTH / SPACING) + 1, 2)
    cloth = Cloth(
        "strip", sheet((LENGTH, SPACING), counts), 0.2, friction=EDGE_FRICTION, damping=0.0,
        bending_stiffness=1e-7, thickness=THICKNESS, self_collisions=False,
    )  # fmt: skip
    return _over_edge(trial, cloth, 0.5 * THICKNESS)


def _rope_edge(trial: Trial) -> Mapping[str, float]:
    points = line(LENGTH, round(LENGTH / SPACING) + 1)
    rope = Rope(
        "strip", points, 0.1, radius=0.5 * THICKNESS, friction=EDGE_FRICTION, damping=0.0, bending_stiffness=1e-7,
        self_collisions=False,
    )  # fmt: skip
    return _over_edge(trial, rope, 0.5 * THICKNESS)


def _over_edge(trial: Trial, strip: Cloth | Rope, clearance: float) -> Mapping[str, float]:
    truth = Edge(LENGTH, RADIUS + clearance, EDGE_FRICTION, G)
    world = trial.world(scene_of_edge(strip), len(SHARES))
    below = [share * truth.limit for share in SHARES]
    rest = torch.as_tensor(strip.rest_positions, dtype=torch.float32)
    starts = [_laid(rest, LENGTH - length, RADIUS + clearance) for length in below]
    body = world.deformables["strip"]
    body.set_state(torch.stack(starts).to(world.device))
    body.anchor(torch.nonzero(rest[:, 0] == rest[:, 0].min())[:, 0].tolist())
    trial.step(world, trial.steps(0.2))  # until it is close to the edge
    body.release()
    ends = body.positions[..., 2].argmin(1)  # the last of what hangs down

    def depths() -> Tensor:
        return -body.positions[torch.arange(len(SHARES)), ends, 2].double().cpu()

    started = depths()
    # Settle first: a hanging part that starts slack would fall before it pulls.
    trial.step(world, trial.steps(0.1))  # until the tension is that of one that slides
    begun, speed = depths(), -float(body.velocities[-1, ends[-1], 2])
    times, moved = _moved(trial, world, depths)
    fastest = truth.slid(below[-1] + float(begun[-1] - started[-1]), times, speed)
    measured = [float(depth - begun[-1]) for depth in moved[:, -1]]
    trial.trace("slid", "m", times, measured, fastest.tolist())
    # What slides has moved by more than half of what the least that slides should have.
    least = truth.slid(below[_FIRST_TO_SLIDE], [0.1 + times[-1]])[0]
    slides = (moved[-1] - started > 0.5 * least).tolist()
    wrong = [abs(share - 1.0) for share, moves in zip(SHARES, slides, strict=True) if moves != (share > 1.0)]
    return {"limit": max(wrong, default=0.0), "slid": abs(measured[-1] / float(fastest[-1]) - 1.0)}


def _moved(trial: Trial, world: World, depths: Callable[[], Tensor]) -> tuple[list[float], Tensor]:
    """Times, and depths (T, N) at these, over 0.3 s."""
    pairs = [(time, depths()) for time in trial.advance(world, 0.3, 0.02)]
    times, found = zip(*pairs, strict=True)
    return list(times), torch.stack(found)


def scene_of_edge(strip: Cloth | Rope) -> Scene:
    """A table whose top is at z = 0 and ends at x = 0, where a quarter of a cylinder begins."""
    material = PhysicsMaterial(EDGE_FRICTION, EDGE_FRICTION)
    half = 0.5 * LENGTH
    shapes = (
        Shape(Box((half, half, 0.5 * RADIUS)), Pose((-half, 0.0, -0.5 * RADIUS)), material),
        Shape(Cylinder(RADIUS, half), Pose.from_euler(0.5 * math.pi, 0.0, 0.0, (0.0, 0.0, -RADIUS)), material),
    )
    link = Link("edge", 1.0, (0.0, 0.0, 0.0), 0.01 * np.eye(3), shapes, shapes)
    table = ObjectSpec(name="edge", articulation=Articulation("edge", (link,)), fixed_base=True)
    return Scene(objects=(table,), deformables=(strip,), terrain=())


def _laid(rest: Tensor, on_table: float, radius: float) -> Tensor:
    """(P, 3) the strip over the edge, ``on_table`` metres before the end of the arc; radius to its middle surface."""
    along = rest[:, 0] + 0.5 * LENGTH - (on_table - 0.5 * math.pi * radius)  # from where the arc begins
    angle = (along / radius).clamp(0.0, 0.5 * math.pi)
    x = torch.where(along < 0.0, along, radius * angle.sin())
    z = radius * angle.cos() - RADIUS - (along - 0.5 * math.pi * radius).clamp(min=0.0)
    return torch.stack((x, rest[:, 1], z), dim=1)


# Fingers and loads ---------------------------------------------------------------------------------------------------


def _cloth_grasp(trial: Trial) -> Mapping[str, float]:
    # The upper edge is held until the fingers have closed.
    held = Attachment(tuple(range(0, 31 * 4, 31)))
    across = Pose.from_euler(0.0, 0.0, 0.5 * math.pi)
    mesh, pose = sheet((0.3, 0.03), (31, 4)), across @ Pose((0.0, 0.0, HALF - 0.13), HANGING)
    cloth = Cloth("strip", mesh, 0.5, pose, friction=1.0, damping=1.0, attachments=(held,))
    return _pinched(trial, cloth)


def _rope_grasp(trial: Trial) -> Mapping[str, float]:
    points, pose = line(0.3, 31), Pose((0.0, 0.0, HALF - 0.13), HANGING)
    rope = Rope("strip", points, 0.1, pose, friction=1.0, damping=1.0, attachments=(Attachment((0,)),))
    return _pinched(trial, rope)


def _pinched(trial: Trial, strip: Cloth | Rope) -> Mapping[str, float]:
    """Two fingers close with 2 N each on what hangs between them by its upper end, which is then let go."""
    hand = gripper(PhysicsMaterial(1.0, 1.0))
    world = trial.world(Scene(robots=(hand,), deformables=(strip,), terrain=()))
    world.robots["gripper"].set_effort_targets(torch.full((1, 2), 2.0, device=world.device), [1, 2])
    # A second for the fingers to close and the strip to hang still.
    trial.step(world, trial.steps(1.0))
    body = world.deformables["strip"]
    before = float(body.positions[0, :, 2].mean())
    body.release()
    error = weight_error(trial, world, "strip", [("gripper", "left"), ("gripper", "right")])
    return {"force": error, "slip": abs(float(body.positions[0, :, 2].mean()) - before)}


def _cloth_weight(trial: Trial) -> Mapping[str, float]:
    cloth = Cloth("cloth", sheet((0.1, 0.1), (9, 9)), 0.5, Pose((0.0, 0.0, 0.204)))
    block = cube("block", half=0.1, pose=Pose((0.0, 0.0, 0.1)))
    world = trial.world(Scene(objects=(block,), deformables=(cloth,)))
    return {"force": weight_error(trial, world, "cloth", [("block", "block")])}


def _cloth_load(trial: Trial) -> Mapping[str, float]:
    """A box falls from 2 cm on a cloth on the ground, and rests on it."""
    mass, half = 1.0, 0.04
    cloth = Cloth("cloth", sheet((0.15, 0.15), (11, 11)), 0.2, Pose((0.0, 0.0, 0.5 * THICKNESS)), thickness=THICKNESS)
    block = cube("block", half, mass, Pose((0.0, 0.0, half + 0.02 + THICKNESS)))
    world = trial.world(Scene(objects=(block,), deformables=(cloth,)))
    # The box has fallen and the cloth has settled by then; the load is a mean over the last 0.2 s.
    trial.step(world, trial.steps(1.2))
    felt, speed, count = 0.0, 0.0, trial.steps(0.2)
    for _ in range(count):
        trial.step(world)
        speed = max(speed, float(world.objects["block"].root_velocity[0, :3].norm()))
        felt += float(world.deformables["cloth"].contact_force("block", "block")[0, 2]) / count
    return {"force": abs(felt / (G * mass) - 1.0), "speed": speed}


SPAN, STRIP, ACROSS, BAR, LOAD = 0.4, 0.5, 0.2, 0.03, 1.0
"""Metres between the ends of a hammock, of its length and width and of the radius of a bar on it; kg of the bar."""
STIFF = 2000.0
"""N/m of the hammock's membrane."""


def _hammock(trial: Trial) -> Mapping[str, float]:
    """A bar of 1 kg is laid into a hammock where it should hang, and comes to rest."""
    rows, columns = 11, 26
    ends = tuple(row * columns + column for row in range(rows) for column in (0, columns - 1))
    held = (Attachment(ends),)
    cloth = Cloth(
        "hammock", sheet((STRIP, ACROSS), (columns, rows)), 0.2, Pose((0.0, 0.0, 1.0)), STIFF, 0.0,
        damping=3.0, thickness=THICKNESS, attachments=held,
    )  # fmt: skip
    hung = _hung()
    turned = Pose((0.0, 0.0, 1.0 - hung.depth), (math.sqrt(0.5), math.sqrt(0.5), 0.0, 0.0))
    bar = cylinder("bar", BAR, 0.3, mass=LOAD, pose=turned)
    world = trial.world(Scene(objects=(bar,), deformables=(cloth,), terrain=()))
    body, points = world.deformables["hammock"], torch.as_tensor(cloth.rest_positions, dtype=torch.float32).clone()
    points[:, 0], points[:, 2] = torch.as_tensor(hung.places(cloth.rest_positions[:, 0])).float().unbind(1)
    # The scene's attachments hold the ends as far apart as the cloth is long; a hammock's are nearer.
    body.release()
    body.set_state(points[None].to(world.device))
    body.anchor(ends)
    trial.step(world, trial.steps(1.2))
    felt, deep, count = 0.0, 0.0, trial.steps(0.5)
    for _ in range(count):
        trial.step(world)
        felt += float(body.contact_force("bar", "bar")[0, 2]) / count
        deep += (1.0 - float(world.objects["bar"].root_pose[0, 2])) / count
    return {"force": abs(felt / (G * LOAD) - 1.0), "depth": abs(deep / hung.depth - 1.0)}


@dataclass(frozen=True)
class _Hung:
    """A light strip under a bar: an arc under it, and two tangents to the ends."""

    depth: float
    """Metres of the bar's axis below the ends."""
    angle: float
    """rad of the tangents, from the horizontal."""
    stretch: float
    """Length over that at rest."""

    def places(self, along: np.ndarray) -> np.ndarray:
        """Return x and z (P, 2) of places at rest along the strip, m from its middle, with the ends at 1 m."""
        way = np.abs(along) * self.stretch
        turned = np.minimum(way / _ROUND, self.angle)
        left = way - turned * _ROUND
        x = _ROUND * np.sin(turned) + left * np.cos(turned)
        z = -_ROUND * np.cos(turned) + left * np.sin(turned)
        return np.column_stack((np.sign(along) * x, 1.0 - self.depth + z))


_ROUND = BAR + 0.5 * THICKNESS


def _hung() -> _Hung:
    """Find how a hammock hangs: its tension stretches it to the length of its way round the bar."""
    low, high, depth, angle, stretch = 0.0, STRIP, 0.0, 0.0, 1.0
    for _ in range(60):
        depth = 0.5 * (low + high)
        away = math.hypot(0.5 * SPAN, depth)
        angle = math.atan2(depth, 0.5 * SPAN) + math.asin(_ROUND / away)
        stretch = 1.0 + 0.5 * G * LOAD / math.sin(angle) / (STIFF * ACROSS)
        way = 2.0 * (math.sqrt(away**2 - _ROUND**2) + angle * _ROUND)
        low, high = (depth, high) if way < STRIP * stretch else (low, depth)
    return _Hung(depth, angle, stretch)


_CAPSTAN = "Meriam and Kraige, Statics, section 6/8, with the strip's own weight and inertia on the arc"
_LIMIT = Metric(
    name="limit",
    unit="",
    tolerance=0.06,
    meaning="relative error of the hanging length at which it begins to slide, known to 0.05",
    looser_because="the lengths tried lie 0.1 apart there",
)
_WAY = "relative error of the way from 0.1 to 0.4 s, with 1.3 of that length"
_FORCE = Metric(
    name="force",
    unit="",
    tolerance=0.02,
    meaning="error of the mean force on both fingers over the weight",
    looser_because=ASKED,
)
_SLIP = "how far its middle moves in the 1.5 s after it is let go"
# Seconds, as in tasks: at 5 ms light fingers chatter on what another solver moves, and feels them a step late.
_FINGERS_STEP = 0.0025
_WEIGHT = "m g down on both fingers together, and nothing across"

SCENARIOS = (
    Scenario(
        name="cloth_slope",
        group=GROUP,
        question="Does cloth hold on a slope below the angle of friction, and slide as Coulomb says above?",
        truth="it holds at tan 0.38; at tan 0.6 it slides with g (sin - mu cos); mu = 0.4",
        source="Meriam and Kraige, Statics, section 6/3; Dynamics, section 3/4",
        needs=(Capability.CLOTH,),
        judges=(Capability.CLOTH,),
        time_steps=TIME_STEPS,
        run=_slope,
        metrics=(
            Metric(
                name="creep",
                unit="m/s",
                tolerance=1e-3,
                meaning="mean speed over 0.4 s on the lesser slope",
                looser_because=ASKED,
            ),
            Metric(
                name="acceleration",
                unit="",
                tolerance=0.03,
                meaning="its relative error over 0.4 s on the steeper slope",
                looser_because=ASKED,
            ),
        ),
    ),
    Scenario(
        name="cloth_edge",
        group=GROUP,
        question="Does a cloth over a rounded edge slide where its end outweighs the capstan's friction, and how fast?",
        truth="T1 / T0 = exp(mu pi / 2), plus the arc's own weight; mu = 0.3",
        source=_CAPSTAN,
        needs=(Capability.CLOTH,),
        judges=(Capability.CLOTH,),
        time_steps=TIME_STEPS,
        run=_cloth_edge,
        metrics=(_LIMIT, Metric(name="slid", unit="", tolerance=0.15, meaning=_WAY)),
    ),
    Scenario(
        name="rope_edge",
        group=GROUP,
        question="Does a rope over a rounded edge slide where its end outweighs the capstan's friction, and how fast?",
        truth="T1 / T0 = exp(mu pi / 2), plus the arc's own weight; mu = 0.3",
        source=_CAPSTAN,
        needs=(Capability.ROPES,),
        judges=(Capability.ROPES,),
        time_steps=TIME_STEPS,
        run=_rope_edge,
        metrics=(
            _LIMIT,
            Metric(
                name="slid",
                unit="",
                tolerance=0.02,
                meaning=_WAY,
                looser_because="errors cancel in the best; at other steps it is 0.01",
            ),
        ),
    ),
    Scenario(
        name="cloth_grasp",
        group=GROUP,
        question="Do two fingers that hold a cloth feel its weight, and does it stay?",
        truth=_WEIGHT,
        source="equilibrium of forces",
        needs=(Capability.CLOTH,),
        judges=(Capability.CLOTH,),
        time_step=_FINGERS_STEP,
        time_steps=TIME_STEPS,
        run=_cloth_grasp,
        metrics=(_FORCE, Metric(name="slip", unit="m", tolerance=1e-3, meaning=_SLIP, looser_because=ASKED)),
    ),
    Scenario(
        name="rope_grasp",
        group=GROUP,
        question="Do two fingers that hold a rope feel its weight, and does it stay?",
        truth=_WEIGHT,
        source="equilibrium of forces",
        needs=(Capability.ROPES,),
        judges=(Capability.ROPES,),
        time_step=_FINGERS_STEP,
        time_steps=TIME_STEPS,
        run=_rope_grasp,
        metrics=(_FORCE, Metric(name="slip", unit="m", tolerance=1e-3, meaning=_SLIP, looser_because=ASKED)),
    ),
    Scenario(
        name="cloth_weight",
        group=GROUP,
        question="Does a box feel the weight of a cloth that lies on it?",
        truth="m g down, and nothing across",
        source="equilibrium of forces",
        needs=(Capability.CLOTH,),
        judges=(Capability.CLOTH,),
        time_steps=TIME_STEPS,
        run=_cloth_weight,
        metrics=(WEIGHT_FELT,),
    ),
    Scenario(
        name="cloth_load",
        group=GROUP,
        question="Does a box of 1 kg that falls on a cloth on the ground come to rest on it?",
        truth="m g up, and no speed, after 1.2 s",
        source="equilibrium of forces",
        needs=(Capability.CLOTH,),
        judges=(Capability.CLOTH,),
        time_steps=TIME_STEPS,
        run=_cloth_load,
        metrics=(
            Metric(
                name="force",
                unit="",
                tolerance=0.02,
                meaning="error of the mean force of the cloth on it, over its weight",
                looser_because=ASKED,
            ),
            Metric(
                name="speed",
                unit="m/s",
                tolerance=0.01,
                meaning="its largest speed in 0.2 s after that",
                looser_because="a centimetre in a second is rest for every purpose",
            ),
        ),
    ),
    Scenario(
        name="cloth_hammock",
        group=GROUP,
        question="How deep does a bar of 1 kg hang in a cloth that is held at its ends, and does it feel its weight?",
        truth="two tangents, 2 T sin(angle) = m g, and the arc under the bar, longer by T / (E t); 0.4 m of 0.5 m",
        source="equilibrium of forces on a light strip without stiffness in bending",
        needs=(Capability.CLOTH,),
        judges=(Capability.CLOTH,),
        time_steps=TIME_STEPS,
        run=_hammock,
        metrics=(
            Metric(
                name="force",
                unit="",
                tolerance=0.02,
                meaning="error of the mean force of the cloth on it, over its weight",
                looser_because=ASKED,
            ),
            Metric(
                name="depth",
                unit="",
                tolerance=0.03,
                meaning="relative error of the depth of its axis below the ends",
                looser_because="it bends round the bar by edges that are two thirds of its radius",
            ),
        ),
    ),
)
