"""Elastic solids on other solids, under cloth, and a ring that closes on itself."""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np
import torch

from orbit_assets.deformables import cuboid, ring, sheet
from orbit_conformance.bodies import WEIGHTLESS, G, cube, on_slope
from orbit_conformance.scenario import Metric, Scenario, Trial
from orbit_conformance.scenarios.ropes import GROUP, TIME_STEPS
from orbit_conformance.scenarios.solid_contact import DENSITY, FRICTION, HOLDING, MODULUS, SIDE, SLIDING
from orbit_conformance.scenarios.solids import PUBLISHED, RATIO
from orbit_core.interfaces import Capability, World
from orbit_core.scene import Attachment, Cloth, Pose, Scene, SoftBody

_HALF = 0.5 * SIDE
_PLATE = 0.04
"""Half the edge of a rigid cube that feels what is on it, m."""


def _block(name: str, pose: Pose) -> SoftBody:
    return SoftBody(name, cuboid((SIDE, SIDE, SIDE), (2, 2, 2)), DENSITY, pose, MODULUS, RATIO, 0.005, FRICTION)


def _felt(trial: Trial, world: World, name: str, seconds: float) -> float:
    """Mean force down on the plate, N."""
    felt, count = 0.0, trial.steps(seconds)
    for _ in range(count):
        trial.step(world)
        felt -= float(world.deformables[name].contact_force("plate", "plate")[0, 2]) / count
    return felt


def _stack(trial: Trial) -> Mapping[str, float]:
    """One block falls on another from 2 mm."""
    plate, top = cube("plate", _PLATE, 2.0, Pose((0.0, 0.0, _PLATE))), 2.0 * _PLATE
    lower = _block("lower", Pose((0.0, 0.0, top + _HALF)))
    upper = _block("upper", Pose((0.0, 0.0, top + 3.0 * _HALF + 0.002)))
    world = trial.world(Scene(objects=(plate,), deformables=(lower, upper)))
    trial.step(world, trial.steps(0.5))
    force = _felt(trial, world, "lower", 0.2)
    speed = float(world.deformables["upper"].velocities.norm(dim=-1).max())
    return {"force": abs(force / (2.0 * G * lower.mass) - 1.0), "speed": speed}


def _slope(trial: Trial) -> Mapping[str, float]:
    crept, _ = _slid(trial, HOLDING)
    _, acceleration = _slid(trial, SLIDING)
    angle = math.atan(SLIDING)
    truth = G * (math.sin(angle) - FRICTION * math.cos(angle))
    return {"creep": crept, "acceleration": abs(acceleration / truth - 1.0)}


def _slid(trial: Trial, tangent: float) -> tuple[float, float]:
    """Metres a second and m/s^2 of a block on a slab that is as soft, over 0.2 s."""
    angle, duration, thickness = math.atan(tangent), 0.2, 0.02
    mesh = cuboid((0.28, 0.08, thickness), (7, 2, 2))
    held = np.flatnonzero(mesh.vertices[:, 2] < -0.49 * thickness)
    slab = SoftBody(
        "slab", mesh, DENSITY, on_slope(angle, -0.5 * thickness), MODULUS, RATIO, 0.005, FRICTION,
        attachments=(Attachment(tuple(held.tolist())),),
    )  # fmt: skip
    pose = on_slope(angle, 0.0) @ Pose((-0.09, 0.0, _HALF))
    world = trial.world(Scene(deformables=(slab, _block("block", pose)), terrain=()))
    body = world.deformables["block"]
    # Until it has slid into the shape that it keeps.
    trial.step(world, trial.steps(0.2))
    before, speed = body.positions[0].mean(0).clone(), body.velocities[0].mean(0).norm().clone()
    trial.step(world, trial.steps(duration))
    moved = float((body.positions[0].mean(0) - before).norm())
    return moved / duration, float(body.velocities[0].mean(0).norm() - speed) / duration


def _draped(trial: Trial) -> Mapping[str, float]:
    """A cloth falls on a block from 5 mm, and hangs down its sides."""
    plate, top = cube("plate", _PLATE, 2.0, Pose((0.0, 0.0, _PLATE))), 2.0 * _PLATE
    block = _block("block", Pose((0.0, 0.0, top + _HALF)))
    edge, density = SIDE + 0.03, 0.5
    cloth = Cloth(
        "cloth", sheet((edge, edge), (13, 13)), density, Pose((0.0, 0.0, top + SIDE + 0.008)), 500.0, damping=2.0,
        thickness=0.003,
    )  # fmt: skip
    world = trial.world(Scene(objects=(plate,), deformables=(block, cloth)))
    trial.step(world, trial.steps(0.8))
    force = _felt(trial, world, "block", 0.3)
    return {
        "force": abs(force / (G * (block.mass + density * edge**2)) - 1.0),
        "speed": float(world.deformables["cloth"].velocities[0].mean(0).norm()),
    }


def _closed(trial: Trial) -> Mapping[str, float]:
    """The two halves of a ring fly towards each other, until its hole is closed and beyond."""
    radius, thickness, speed = 0.04, 0.01, 1.2
    mesh = ring(radius, thickness)
    body = SoftBody("ring", mesh, DENSITY, Pose(), 3e3, RATIO, 0.002, 0.0, resolution=0.0201)
    world = trial.world(Scene(deformables=(body,), terrain=(), gravity=WEIGHTLESS))
    found, place = world.deformables["ring"], torch.as_tensor(mesh.vertices[:, 0])
    velocities = torch.zeros_like(found.positions)
    velocities[0, :, 0] = (-speed * place / radius).clamp(-speed, speed).to(velocities)
    found.set_state(found.positions, velocities)
    # The two sides of the hole, where they meet.
    inner = torch.as_tensor(np.abs(np.hypot(mesh.vertices[:, 0], mesh.vertices[:, 1]) - radius + thickness) < 1e-6)
    sides = [inner & (sign * place > 0.9 * (radius - thickness)) for sign in (1, -1)]
    times, gaps = [], []
    for time in trial.advance(world, 0.12):
        across = found.positions[0, :, 0].cpu()
        times.append(time)
        gaps.append(float(across[sides[0]].mean() - across[sides[1]].mean()))
    trial.trace("gap", "m", times, gaps, [0.0] * len(times))
    return {"overlap": max(-min(gaps), 0.0), "open": max(min(gaps), 0.0)}


SCENARIOS = (
    Scenario(
        name="solid_stack",
        group=GROUP,
        question="Does the lower of two soft blocks bear the upper one, and does what is below feel both?",
        truth="2 m g on the plate below, and no speed",
        source="equilibrium of forces",
        needs=(Capability.SOFT_BODIES,),
        judges=(Capability.SOFT_BODIES,),
        time_steps=TIME_STEPS,
        run=_stack,
        metrics=(
            Metric(
                name="force",
                unit="",
                tolerance=0.01,
                meaning="error of the force below over the weight of both",
                looser_because=PUBLISHED,
            ),
            Metric(
                name="speed",
                unit="m/s",
                tolerance=0.03,
                meaning="largest of a vertex",
                looser_because="its corners swing for long: natively on MuJoCo at 0.003 to 0.02 m/s for two seconds",
            ),
        ),
    ),
    Scenario(
        name="solid_soft_slope",
        group=GROUP,
        question="Does a soft block hold and slide on a soft slab as Coulomb says?",
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
                meaning="mean speed over 0.2 s on the lesser slope",
                looser_because=PUBLISHED,
            ),
            Metric(
                name="acceleration",
                unit="",
                tolerance=0.05,
                meaning="its relative error over 0.2 s on the steeper slope",
                looser_because="the slab dents under the block, which rubs along its edges",
            ),
        ),
    ),
    Scenario(
        name="solid_draped",
        group=GROUP,
        question="Does a soft block carry the cloth that falls on it?",
        truth="the weight of both on the plate below, and no speed",
        source="equilibrium of forces",
        needs=(Capability.SOFT_BODIES, Capability.CLOTH),
        judges=(Capability.SOFT_BODIES,),
        time_steps=TIME_STEPS,
        run=_draped,
        metrics=(
            Metric(
                name="force",
                unit="",
                tolerance=0.02,
                meaning="error of the force below over the weight of both",
                looser_because=PUBLISHED,
            ),
            Metric(
                name="speed",
                unit="m/s",
                tolerance=0.1,
                meaning="of the cloth's middle of mass",
                looser_because="its corners swing for long: natively on MuJoCo at 0.04 to 0.08 m/s two seconds later",
            ),
        ),
    ),
    Scenario(
        name="solid_ring",
        group=GROUP,
        question="Do the two sides of a soft ring meet whose halves fly towards each other?",
        truth="they touch: no gap, and no overlap",
        source="matter does not pass through itself",
        needs=(Capability.SOFT_BODIES,),
        judges=(Capability.SOFT_BODIES,),
        time_step=0.005,
        time_steps=(0.005,),
        run=_closed,
        metrics=(
            Metric(
                name="overlap",
                unit="m",
                tolerance=1e-3,
                meaning="of the two sides of the hole",
                looser_because="contacts are compliant, and a tenth of the ring's section shows",
            ),
            Metric(
                name="open",
                unit="m",
                tolerance=1e-3,
                meaning="left between them where they are nearest",
                looser_because="the sides dent",
            ),
        ),
    ),
)
