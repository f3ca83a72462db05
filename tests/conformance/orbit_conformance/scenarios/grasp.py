"""A grasp that holds by friction alone."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import torch
from torch import Tensor

from orbit_conformance.bodies import SMOOTH_GROUND, G, block, scene, smooth_material
from orbit_conformance.scenario import Metric, Scenario, Trial
from orbit_core.interfaces import Capability, World
from orbit_core.scene import (
    Articulation,
    Box,
    Geometry,
    ImplicitPd,
    Joint,
    JointType,
    Link,
    PhysicsMaterial,
    Pose,
    RobotSpec,
    Shape,
)

MASS, FRICTION, HALF = 1.0, 0.5, 0.03
# Metres between the open fingers and the box.
GAP = 0.002
LIFT = 0.05
# Ratio in each environment of the weight to the load that the fingers can hold: ``m g / (2 mu F)``.
LOADS = torch.arange(0.91, 1.1, 0.02)


def gripper(material: PhysicsMaterial, tip: Geometry | None = None) -> RobotSpec:
    """A hand on a vertical slide, and two fingers that close along y with the effort that they are given.

    ``tip`` is the shape of a finger, 10 mm to its surface; a box where it is left out.
    """
    pad = Shape(tip or Box((0.02, 0.01, 0.02)), material=material)
    links = [Link("base", 1.0, (0.0, 0.0, 0.0), np.eye(3) * 0.01), Link("hand", 1.0, (0.0, 0.0, 0.0), np.eye(3) * 0.01)]
    joints = [Joint("lift", JointType.PRISMATIC, "base", "hand", lower_limit=-1.0, upper_limit=1.0)]
    for name, side in (("left", 1.0), ("right", -1.0)):
        links.append(Link(name, 0.2, (0.0, 0.0, 0.0), np.eye(3) * 1e-4, (pad,), (pad,)))
        at = Pose((0.0, side * (HALF + GAP + 0.01), 0.0))
        joints.append(
            Joint(f"{name}_slide", JointType.PRISMATIC, "hand", name, at, axis=(0.0, -side, 0.0),
                  lower_limit=-0.05, upper_limit=0.05)
        )  # fmt: skip
    return RobotSpec(
        name="gripper", articulation=Articulation("gripper", tuple(links), tuple(joints)), fixed_base=True,
        pose=Pose((0.0, 0.0, HALF)), gravity_compensation=True,
        actuators=(
            # Stiff enough to lift by position without a sag that would count as slip.
            ImplicitPd(joints=("lift",), stiffness=2e5, damping=4e3),
            ImplicitPd(joints=(".*_slide",), stiffness=0.0, damping=20.0),
        ),
    )  # fmt: skip


def _offset(world: World) -> Tensor:
    """Height (N,) of the box above the fingers' middle, in metres."""
    fingers = world.robots["gripper"].link_poses[:, 2:, 2].mean(-1)
    return world.objects["box"].root_pose[:, 2] - fingers


def _grasp(trial: Trial) -> Mapping[str, float]:
    material = smooth_material(FRICTION)
    thing = block("box", 2 * HALF, material, Pose((0.0, 0.0, HALF)), MASS)
    world = trial.world(scene(gripper(material), thing, terrain=SMOOTH_GROUND), len(LOADS))
    # Gripped at half the limit in all environments, and loosened only after the lift.
    squeeze(world, 0.5 * torch.ones_like(LOADS))
    trial.step(world, trial.steps(0.2))
    before = _offset(world).clone()
    lift(trial, world)
    lifted = _offset(world).clone()
    squeeze(world, LOADS)
    trial.step(world, trial.steps(0.1))
    start = _offset(world).clone()
    duration = 0.3
    trial.step(world, trial.steps(duration))
    slipped = start - _offset(world)
    # The first load above the limit slips by g (1 - 1 / load) t^2 / 2, and further if it slipped before.
    # A quarter of the slip of a load 1 % above the limit separates creep from sliding.
    holds = slipped < 0.25 * G * (1 - 1 / 1.01) * duration**2
    strongest = LOADS[holds].max() if holds.any() else LOADS[0] - 0.02
    return {
        "lift": float((lifted - before).abs().max()),
        "limit": abs(float(strongest) + 0.01 - 1),
        "creep": float(slipped[LOADS < 0.95].abs().max()) / duration,
    }


def lift(trial: Trial, world: World) -> None:
    """Raise the hand by :data:`LIFT` within 0.6 s, smoothly."""
    for time in trial.advance(world, 0.6):
        share = time / 0.6
        height = LIFT * share * share * (3 - 2 * share)
        world.robots["gripper"].set_position_targets(torch.full((world.num_envs, 1), height), [0])


def squeeze(world: World, loads: Tensor) -> None:
    """Close the fingers with such efforts that the weight is ``loads`` (N,) times what they can hold."""
    force = MASS * G / (2 * FRICTION * loads)
    world.robots["gripper"].set_effort_targets(force[:, None].expand(-1, 2), [1, 2])


SCENARIOS = (
    Scenario(
        name="grasp",
        group="Grasp",
        question="Do two fingers hold a box by friction up to the weight that Coulomb's law allows, and no further?",
        truth="it holds while m g < 2 mu F; mu = 0.5, m = 1 kg",
        source="Murray, Li and Sastry, A Mathematical Introduction to Robotic Manipulation, section 5.2",
        judges=(Capability.FRICTION,),
        run=_grasp,
        metrics=(
            Metric(
                name="lift",
                unit="m",
                tolerance=0.002,
                meaning="slip while the box is lifted 50 mm with twice the force that its weight needs",
            ),
            Metric(
                name="limit",
                unit="",
                tolerance=0.015,
                meaning="relative error of the greatest load m g / (2 mu F) that holds, known to 0.01",
                looser_because="the loads tried lie 0.02 apart",
            ),
            Metric(name="creep", unit="m/s", tolerance=0.01, meaning="speed of slip at loads of 0.91 and 0.93"),
        ),
    ),
)
