"""A peg that two points on opposite sides hold wedged, or let go."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
import torch

from orbit_assets.objects import box
from orbit_conformance.bodies import WEIGHTLESS, body, scene
from orbit_conformance.contact import smooth_material
from orbit_conformance.scenario import Metric, Scenario, Trial
from orbit_core.dynamics.transforms import rotation_angle
from orbit_core.interfaces import Capability
from orbit_core.scene import Articulation, ImplicitPd, Joint, JointType, Link, Pose, RobotSpec, Shape, Sphere

_WIDTH, _LENGTH, _MU, _SQUEEZE, _STIFFNESS, _TIP = 0.05, 0.1, 0.4, 5.0, 1e3, 0.01
# Heights of the right point over the left one's, over friction times the peg's width: below 1 the peg is wedged.
_DEPTHS = (0.5, 0.8, 0.9, 1.1, 1.2, 1.5)
# Pulls at the first peg over the greatest that holds: one to each environment.
_PULLS = (0.0, 0.5, 0.8, 0.9, 1.1, 1.2, 1.5)
# Metres between pegs; the turn (rad) by which a peg counts as let go, and the way (m) by which the first does. One
# that goes turns until the line between the points lies in the cones: at 1.1 it swings to 0.06 rad.
_APART, _TURNED, _MOVED = 0.2, 0.04, 0.001


def _points() -> RobotSpec:
    """Build for each peg a ball on its left side, and one on its right that a force presses on along x."""
    tip = Shape(Sphere(_TIP), material=smooth_material(_MU))
    inertia, reach = np.eye(3) * 0.01, 0.5 * _WIDTH + _TIP
    links, joints = [body("base")], list[Joint]()
    for number, depth in enumerate(_DEPTHS):
        for side in (-1.0, 1.0):
            name = f"{'left' if side < 0.0 else 'right'}{number}"
            links.append(Link(name, 1.0, (0.0, 0.0, 0.0), inertia, (tip,), (tip,)))
            place = Pose((side * reach, _APART * number, 0.5 * side * depth * _MU * _WIDTH))
            if side < 0.0:
                joints.append(Joint(name, JointType.FIXED, "base", name, place))
            else:
                slide = Joint(name, JointType.PRISMATIC, "base", name, place, axis=(1.0, 0.0, 0.0))
                joints.append(replace(slide, lower_limit=-0.1, upper_limit=0.1))
    return RobotSpec(
        name="points",
        articulation=Articulation("points", tuple(links), tuple(joints)),
        fixed_base=True,
        actuators=(ImplicitPd(joints=("right.*",), stiffness=_STIFFNESS, damping=60.0),),
    )


def _wedging(trial: Trial) -> Mapping[str, float]:
    """Weightless pegs between two points, the right one the higher: friction at both must bear the couple of the two
    pushes N l, which it does up to mu N b. What is left of it holds the first peg against a pull along its sides."""
    material = smooth_material(_MU)
    pegs = [
        box(
            f"peg{number}", (_WIDTH, 0.05, _LENGTH), mass=1.0, material=material, pose=Pose((0.0, _APART * number, 0.0))
        )
        for number in range(len(_DEPTHS))
    ]
    world = trial.world(scene(_points(), *pegs, terrain=(), gravity=WEIGHTLESS), len(_PULLS))
    robot, things = world.robots["points"], list(world.objects.values())
    robot.set_position_targets(torch.full_like(robot.joint_positions, -_SQUEEZE / _STIFFNESS))
    pulls = torch.tensor(_PULLS, device=world.device)
    force = torch.zeros(len(_PULLS), 1, 6, device=world.device)

    def advance(seconds: float) -> None:
        for _ in range(trial.steps(seconds)):
            things[0].set_wrenches(force)
            trial.step(world, 1)

    advance(0.2)
    before = torch.stack([thing.root_pose for thing in things], dim=1).clone()
    force[:, 0, 2] = 2.0 * _MU * _SQUEEZE * (1.0 - _DEPTHS[0]) * pulls
    advance(0.6)
    after = torch.stack([thing.root_pose for thing in things], dim=1)
    way, turn = (after - before)[..., :3].norm(dim=-1), rotation_angle(after[..., 3:])
    depths = torch.tensor(_DEPTHS, device=world.device)
    wrong = [
        (depths - 1.0).abs()[(turn[0] > _TURNED) != (depths > 1.0)],
        (pulls - 1.0).abs()[(way[:, 0] > _MOVED) != (pulls > 1.0)],
    ]
    wedge, pull = (float(each.max()) if len(each) else 0.0 for each in wrong)
    return {"wedge": wedge, "pull": pull, "creep": float(way[0, depths < 0.9].max()) / 0.6}


SCENARIOS = (
    Scenario(
        name="wedged_peg",
        group="Friction",
        question="Is a peg wedged between two points where the line between them lies in both cones of friction?",
        truth="wedged for l < mu b, points l apart along it and b across; held by N against 2 N (mu - l / b)",
        source="Whitney, Quasi-static assembly of compliantly supported rigid parts, J. Dyn. Sys. 104, 1982: wedging",
        needs=(Capability.IMPLICIT_DRIVES,),
        run=_wedging,
        judges=(Capability.FRICTION,),
        metrics=(
            Metric(
                name="wedge",
                unit="",
                tolerance=0.11,
                meaning="largest |l / (mu b) - 1| at which a peg goes that should stay, or stays",
                looser_because="told apart in steps of 10 %; the best engines tell all of them",
            ),
            Metric(
                name="pull",
                unit="",
                tolerance=0.11,
                meaning="largest |F / (2 N (mu - l / b)) - 1| at which the first peg goes that should stay, or stays",
                looser_because="told apart in steps of 10 %; the best engines tell all of them",
            ),
            Metric(
                name="creep",
                unit="m/s",
                tolerance=1e-4,
                meaning="fastest mean motion of pegs that are wedged by a tenth or more",
                looser_because="a millimetre in ten seconds; the best hold to rounding error",
            ),
        ),
    ),
)
