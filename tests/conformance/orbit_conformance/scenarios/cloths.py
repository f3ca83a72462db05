"""Cloth that hangs, bends and flies."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import torch
from torch import Tensor

from orbit_assets.deformables import sheet
from orbit_conformance.bodies import WEIGHTLESS, G
from orbit_conformance.scenario import FIRST_ORDER, SINGLE, Metric, Scenario, Trial
from orbit_conformance.scenarios.ropes import ASKED, GROUP, HANGING, TIME_STEPS
from orbit_conformance.slender import elastica_droop
from orbit_core.interfaces import Capability
from orbit_core.scene import Attachment, Cloth, Pose, Scene

# Rows of the hanging cloth.
MESHES = (7, 13, 21)


def _hanging(trial: Trial) -> Mapping[str, float]:
    return {f"length_{count}": _hanging_error(trial, count) for count in MESHES}


def _hanging_error(trial: Trial, count: int) -> float:
    length, density, stiffness = 0.3, 0.2, 2000.0
    held = Attachment(tuple(range(0, count * count, count)))
    pose, mesh = Pose((0.0, 0.0, 1.0), HANGING), sheet((length, length), (count, count))
    cloth = Cloth("cloth", mesh, density, pose, stiffness, damping=2.0, attachments=(held,))
    world = trial.world(Scene(deformables=(cloth,), terrain=()))
    trial.step(world, trial.steps(1.5))
    heights = world.deformables["cloth"].positions[0, :, 2]
    # Each row bears the cloth below it, so that the strain falls evenly to zero: half the stretch of a load at the
    # end.
    truth = length + 0.5 * density * G * length**2 / stiffness
    return abs(float(heights.max() - heights.min()) / truth - 1.0)


def _strip(trial: Trial) -> Mapping[str, float]:
    stiffness, ratio, density, length, width = 40.0, 0.3, 0.4, 0.4, 0.1
    held = Attachment(tuple(range(0, 17 * 5, 17)))
    pose, mesh = Pose((0.0, 0.0, 1.0), HANGING), sheet((length, width), (17, 5))
    cloth = Cloth("strip", mesh, density, pose, stiffness, ratio, damping=3.0, attachments=(held,))
    world = trial.world(Scene(deformables=(cloth,), terrain=()))
    trial.step(world, trial.steps(2.5))
    # Contraction is measured in the middle of the strip, since the held edge cannot narrow.
    points = world.deformables["strip"].positions[0].reshape(5, 17, 3)
    longer = float(points[2, 0, 2] - points[2, -1, 2]) - length
    narrower = width - float((points[-1, 8, 1] - points[0, 8, 1]).norm())
    strain = 0.5 * density * G * length / stiffness
    return {
        "stretch": abs(longer / (strain * length) - 1.0),
        "contraction": abs(narrower / (ratio * strain * width) - 1.0),
    }


def _cantilever(trial: Trial) -> Mapping[str, float]:
    length, density, stiffness, count = 0.1, 0.2, 1e-4, 11
    mesh = sheet((length * count / (count - 1), 0.03), (count + 1, 4))
    # Two columns are held: one would be a hinge, two clamp the strip level.
    held = Attachment(tuple(row * (count + 1) + column for row in range(4) for column in (0, 1)))
    pose, still = Pose((0.0, 0.0, 1.0)), 6.0
    cloth = Cloth("strip", mesh, density, pose, 2000.0, 0.0, stiffness, still, attachments=(held,))
    world = trial.world(Scene(deformables=(cloth,), terrain=()))
    trial.step(world, trial.steps(3.0))
    tip = world.deformables["strip"].positions[0].reshape(4, count + 1, 3)[1:3, -1, 2].mean()
    return {"droop": abs((1.0 - float(tip)) / elastica_droop(length, density * G, stiffness) - 1.0)}


def vertex_masses(cloth: Cloth) -> Tensor:
    """(P,) kg: a third of each triangle at each of its corners."""
    faces = np.asarray(cloth.mesh.faces)
    a, b, c = (cloth.rest_positions[faces[:, corner]] for corner in range(3))
    shares = np.zeros(len(cloth.rest_positions))
    np.add.at(shares, faces, (cloth.area_density * np.linalg.norm(np.cross(b - a, c - a), axis=1) / 6.0)[:, None])
    return torch.as_tensor(shares, dtype=torch.float64)


def _free(trial: Trial) -> Mapping[str, float]:
    """Two environments: one turns as a whole, in the other each particle moves at random as well."""
    cloth = Cloth("cloth", sheet((0.2, 0.2), (9, 9)), 0.2, damping=0.0)
    world = trial.world(Scene(deformables=(cloth,), terrain=(), gravity=WEIGHTLESS), 2)
    body, masses = world.deformables["cloth"], vertex_masses(cloth)
    turn = torch.tensor([3.0, 0.0, 4.0], device=world.device).expand(2, 81, 3)
    onward = torch.tensor([1.0, 0.0, 0.5], device=world.device)
    velocities = torch.linalg.cross(turn, body.positions) + onward
    # The noise excites every mode of the mesh, which a rigid turn does not.
    noise = 0.3 * torch.randn(81, 3, generator=torch.Generator().manual_seed(0))
    velocities[1] += noise.to(velocities.device)
    body.set_state(body.positions.clone(), velocities)

    def measured() -> tuple[Tensor, Tensor, float]:
        x, v = body.positions.double().cpu(), body.velocities.double().cpu()
        moments = masses[:, None] * v
        # Angular momentum about the moving centre of mass, so that translation does not add to it.
        x = x - (masses[:, None] * x).sum(1, keepdim=True) / masses.sum()
        return moments.sum(1), torch.linalg.cross(x, moments).sum(1), 0.5 * float((moments[0] * v[0]).sum())

    linear, angular, energy = measured()
    times, energies = [], []
    for time in trial.advance(world, 1.0, 0.02):
        times.append(time)
        energies.append(measured()[2])
    after = measured()
    trial.trace("energy", "J", times, energies, [energy] * len(times))
    return {
        "linear_momentum": float(((after[0] - linear).norm(dim=1) / linear.norm(dim=1)).max()),
        "angular_momentum": float(((after[1] - angular).norm(dim=1) / angular.norm(dim=1)).max()),
        "energy": max(abs(one / energy - 1.0) for one in energies),
    }


SCENARIOS = (
    Scenario(
        name="cloth_hanging",
        question="Does a hanging cloth keep its length, however fine its mesh?",
        truth="L + rho g L^2 / (2 E t), L = 0.3 m",
        source="Timoshenko and Goodier, Theory of Elasticity, 3rd ed., section 96",
        run=_hanging,
        metrics=tuple(
            Metric(
                name=f"length_{count}",
                unit="",
                tolerance=0.01,
                meaning=f"relative error of its length, {count} x {count} particles",
                looser_because=ASKED,
            )
            for count in MESHES
        ),
        group=GROUP,
        needs=(Capability.CLOTH,),
        judges=(Capability.CLOTH,),
        time_steps=TIME_STEPS,
    ),
    Scenario(
        name="cloth_stretch",
        question="Does a soft strip stretch under its weight as its modulus says, and narrow by Poisson's ratio?",
        truth="rho g L^2 / (2 E t) in all, and nu times the strain there across its middle",
        source="Timoshenko and Goodier, Theory of Elasticity, 3rd ed., section 96",
        run=_strip,
        metrics=(
            Metric(name="stretch", unit="", tolerance=0.08, meaning="relative error of what it is longer by"),
            Metric(
                name="contraction",
                unit="",
                tolerance=0.12,
                meaning="relative error of what its middle is narrower by",
                looser_because=FIRST_ORDER,
            ),
        ),
        group=GROUP,
        needs=(Capability.CLOTH,),
        judges=(Capability.CLOTH,),
        time_steps=TIME_STEPS,
    ),
    Scenario(
        name="cloth_cantilever",
        question="Does a strip that is held level at one end droop as its bending stiffness says?",
        truth="B theta'' = -w (L - s) cos(theta), theta(0) = 0, theta'(L) = 0; Peirce's bending length is 37 mm",
        source="Peirce, The handle of cloth as a measurable quantity, 1930; Bickley, The heavy elastica, 1934",
        run=_cantilever,
        metrics=(Metric(name="droop", unit="", tolerance=0.1, meaning="relative error of how far the tip falls"),),
        group=GROUP,
        needs=(Capability.CLOTH,),
        judges=(Capability.CLOTH,),
        time_steps=TIME_STEPS,
    ),
    Scenario(
        name="cloth_free",
        question="Does a cloth that flies and turns keep its momenta and its energy?",
        truth="they are constant",
        source="Goldstein, Poole and Safko, Classical Mechanics, 3rd ed., section 1.2",
        run=_free,
        metrics=(
            Metric(
                name="linear_momentum", unit="", tolerance=1e-5, meaning="relative change in 1 s", looser_because=SINGLE
            ),
            Metric(
                name="angular_momentum", unit="", tolerance=0.05, meaning="relative change in 1 s, about its middle"
            ),
            Metric(
                name="energy",
                unit="",
                tolerance=0.01,
                meaning="largest relative change in 1 s of one that turns as a whole",
            ),
        ),
        group=GROUP,
        needs=(Capability.CLOTH,),
        judges=(Capability.CLOTH,),
        time_steps=TIME_STEPS,
    ),
)
