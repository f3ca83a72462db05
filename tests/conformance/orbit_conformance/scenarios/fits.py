"""Contact as tight fits and games have it: a peg that jams, a puck on ice, a rod that two fingers roll."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import torch

from orbit_assets.objects import box, cylinder
from orbit_conformance.bodies import SMOOTH, WEIGHTLESS, G, body, fixed, scene
from orbit_conformance.contact import SMOOTH_GROUND, smooth_material
from orbit_conformance.scenario import Metric, Scenario, Trial
from orbit_core.interfaces import Capability
from orbit_core.scene import Articulation, Box, ImplicitPd, Joint, JointType, Link, Pose, RobotSpec, Shape

# A peg in a slot -----------------------------------------------------------------------------------------------------

_WIDTH, _LENGTH, _CLEARANCE, _MU, _FORCE = 0.05, 0.1, 2e-4, 0.3, 2.0
# Offsets of the force over that at which the peg jams.
_SHARES = (0.0, 0.5, 0.8, 0.9, 1.1, 1.2, 1.5)


def _jamming(trial: Trial) -> Mapping[str, float]:
    """A weightless peg between two walls is pushed along them by a force off its middle, one for each environment.

    It leans on both walls with N = F e / l, whose friction holds it back by 2 mu N. What it still gains of speed is
    what the force of insertion lacks.
    """
    half = 0.5 * (_WIDTH + _CLEARANCE) + 0.05
    walls = [fixed(f"wall{side}", Box((0.05, 0.1, 1.5)), Pose((side * half, 0.0, 0.0)), SMOOTH) for side in (-1, 1)]
    peg = box("peg", (_WIDTH, 0.05, _LENGTH), mass=1.0, material=smooth_material(_MU), pose=Pose((0.0, 0.0, 0.7)))
    world = trial.world(scene(peg, *walls, terrain=(), gravity=WEIGHTLESS), len(_SHARES))
    shares = torch.tensor(_SHARES, device=world.device)
    thing = world.objects["peg"]
    push = torch.zeros(len(_SHARES), 1, 6, device=world.device)
    push[:, 0, 2], push[:, 0, 4] = -_FORCE, _FORCE * shares * _LENGTH / (2.0 * _MU)
    settle, time = 0.2, 0.6

    def advance(seconds: float) -> None:
        for _ in range(trial.steps(seconds)):
            thing.set_wrenches(push)
            trial.step(world, 1)

    advance(settle)
    before = thing.root_velocity[:, 2].clone()
    advance(time)
    share = (before - thing.root_velocity[:, 2]) / (time * _FORCE)
    truth = (1.0 - shares).clamp_min(0.0)
    return {
        "insertion": float((share - truth)[shares < 1.0].abs().max()),
        "jam": float(share[shares > 1.0].abs().max()),
    }


# A puck --------------------------------------------------------------------------------------------------------------

_ICE, _SPEED, _REBOUND, _RUN = 0.04, 0.8, 0.8, 0.1


def _puck(trial: Trial) -> Mapping[str, float]:
    """Two pucks slide over ice: one until it stops, one against a board, which throws it back."""
    ice = smooth_material(_ICE)
    poses = (Pose((0.0, 0.0, 0.01)), Pose((0.0, 1.0, 0.01)))
    free = cylinder("free", 0.03, 0.02, mass=0.1, material=ice, pose=poses[0])
    hard = cylinder("hard", 0.03, 0.02, mass=0.1, material=smooth_material(_ICE, _REBOUND), pose=poses[1])
    board = fixed("board", Box((0.05, 0.3, 0.05)), Pose((_RUN + 0.03 + 0.05, 1.0, 0.051)), SMOOTH)
    world = trial.world(scene(free, hard, board, terrain=SMOOTH_GROUND))
    trial.step(world, trial.steps(0.1))
    velocity = torch.tensor([[_SPEED, 0.0, 0.0, 0.0, 0.0, 0.0]], device=world.device)
    pucks = [world.objects[name] for name in ("free", "hard")]
    start = [puck.root_pose[0, 0].item() for puck in pucks]
    for puck in pucks:
        puck.set_root_velocity(velocity)
    reach, curve = 0.0, []
    for time in trial.advance(world, _SPEED / (_ICE * G) + 0.2, every=0.05):
        reach = max(reach, pucks[1].root_pose[0, 0].item() - start[1])
        curve.append((time, pucks[0].root_pose[0, 0].item() - start[0], _slid(time)))
    trial.trace("way of the free puck", "m", *zip(*curve, strict=True))
    stop = _SPEED**2 / (2.0 * _ICE * G)
    before = _SPEED**2 - 2.0 * _ICE * G * _RUN
    back = _REBOUND**2 * before / (2.0 * _ICE * G)
    slid, came = (puck.root_pose[0, 0].item() - begin for puck, begin in zip(pucks, start, strict=True))
    return {"stop": abs(slid / stop - 1.0), "rebound": abs((_RUN - came) / back - 1.0)}


def _slid(time: float) -> float:
    """Metres that the free puck has slid after so many seconds."""
    own = min(time, _SPEED / (_ICE * G))
    return _SPEED * own - 0.5 * _ICE * G * own**2


# A rod between two fingers -------------------------------------------------------------------------------------------

_ROD, _PACE, _SQUEEZE = 0.02, 0.05, 5.0


def _fingers() -> RobotSpec:
    """Two plates across x that slide along z by velocity drives; the second is pressed on by a force along x."""
    plate = Shape(Box((0.01, 0.05, 0.15)), material=smooth_material(0.8))
    inertia = np.eye(3) * 0.01
    links = (
        body("base"),
        Link("left", 1.0, (0.0, 0.0, 0.0), inertia, (plate,), (plate,)),
        body("slide"),
        Link("right", 1.0, (0.0, 0.0, 0.0), inertia, (plate,), (plate,)),
    )
    up, across = (0.0, 0.0, 1.0), (1.0, 0.0, 0.0)
    left, right = Pose((-_ROD - 0.01, 0.0, 0.0)), Pose((_ROD + 0.01, 0.0, 0.0))
    joints = (
        Joint("left", JointType.PRISMATIC, "base", "left", left, axis=up, lower_limit=-1.0, upper_limit=1.0),
        Joint("press", JointType.PRISMATIC, "base", "slide", right, axis=across, lower_limit=-1.0, upper_limit=1.0),
        Joint("right", JointType.PRISMATIC, "slide", "right", axis=up, lower_limit=-1.0, upper_limit=1.0),
    )
    drives = (
        ImplicitPd(joints=("left", "right"), damping=1e3),
        ImplicitPd(joints=("press",), stiffness=1e3, damping=60.0),
    )
    return RobotSpec(
        name="fingers", articulation=Articulation("fingers", links, joints), fixed_base=True, actuators=drives
    )


def _rolling_rod(trial: Trial) -> Mapping[str, float]:
    """Plates that move against each other spin the rod on the spot; moved alike, they carry it; one moved, it rolls."""
    rod = cylinder(
        "rod", _ROD, 0.06, mass=0.1, material=smooth_material(0.8), pose=Pose.from_euler(np.pi / 2, 0.0, 0.0)
    )
    paces = torch.tensor([(_PACE, -_PACE), (_PACE, _PACE), (_PACE, 0.0)])
    world = trial.world(scene(_fingers(), rod, terrain=(), gravity=WEIGHTLESS), len(paces))
    robot, thing, paces = world.robots["fingers"], world.objects["rod"], paces.to(world.device)
    order = [robot.joint_names.index(name) for name in ("left", "right", "press")]
    position, velocity = (
        torch.zeros(len(paces), 3, device=world.device),
        torch.zeros(len(paces), 3, device=world.device),
    )
    position[:, order[2]] = -_SQUEEZE / 1e3
    robot.set_position_targets(position)
    trial.step(world, trial.steps(0.3))
    velocity[:, order[:2]] = paces
    robot.set_velocity_targets(velocity)
    trial.step(world, trial.steps(0.2))
    before = thing.root_pose[:, 2].clone()
    seconds = 0.8
    trial.step(world, trial.steps(seconds))
    carried = (thing.root_pose[:, 2] - before) / seconds - paces.mean(1)
    spin = thing.root_velocity[:, 4] * _ROD - 0.5 * (paces[:, 0] - paces[:, 1])
    return {"spin": float(spin.abs().max()) / _PACE, "carried": float(carried.abs().max()) / _PACE}


SCENARIOS = (
    Scenario(
        name="jamming_peg",
        group="Friction",
        question="Does a peg in a tight slot go in with the force that friction at two points leaves, and jam beyond?",
        truth="a = F / m (1 - 2 mu e / l) for a force F beside the middle by e, and none from e = l / (2 mu) on",
        source="Whitney, Quasi-static assembly of compliantly supported rigid parts, J. Dyn. Sys. 104, 1982: jamming",
        run=_jamming,
        judges=(Capability.FRICTION,),
        metrics=(
            Metric(
                name="insertion",
                unit="",
                tolerance=0.04,
                meaning="largest error of m a / F of pegs that go in",
                looser_because="4 % of the push are less than a wrist's sensor tells; the best is at 0.1 %",
            ),
            Metric(
                name="jam",
                unit="",
                tolerance=0.01,
                meaning="largest m a / F of pegs that should jam",
                looser_because="a hundredth of the push; the best engines hold a jam to rounding error",
            ),
        ),
    ),
    Scenario(
        name="puck",
        group="Impact",
        question="Does a puck on ice stop, and come back from a board, after the way that it should?",
        truth="s = v^2 / (2 mu g), and after the board e^2 (v^2 - 2 mu g d) / (2 mu g)",
        source="Meriam and Kraige, Dynamics, 7th ed., sections 3/6 (friction) and 3/12 (restitution)",
        run=_puck,
        judges=(Capability.FRICTION, Capability.RESTITUTION),
        metrics=(
            Metric(
                name="stop",
                unit="",
                tolerance=6e-3,
                meaning="error of the free puck's way over that way",
            ),
            Metric(
                name="rebound",
                unit="",
                tolerance=0.06,
                meaning="error of the way back from the board over that way",
                looser_because="the way goes with the square of the coefficient: 3 % of that, where the best has 0.3 %",
            ),
        ),
    ),
    Scenario(
        name="rod_between_fingers",
        group="Friction",
        question="Do two fingers spin a rod between them on the spot, carry it, or roll it, by how they move?",
        truth="spin (u - w) / (2 r) and speed (u + w) / 2 between fingers of speeds u and w",
        source="Mason, Mechanics of Robotic Manipulation, section 2.4 (rolling contact)",
        needs=(Capability.IMPLICIT_DRIVES,),
        run=_rolling_rod,
        judges=(Capability.FRICTION,),
        metrics=(
            Metric(
                name="spin",
                unit="",
                tolerance=0.03,
                meaning="largest error of spin times radius over a finger's speed",
                looser_because="engines that iterate end a little short of rolling; the best is at 0.3 %",
            ),
            Metric(
                name="carried",
                unit="",
                tolerance=0.03,
                meaning="largest error of the rod's speed over a finger's",
                looser_because="as of the spin; the best is at rounding error",
            ),
        ),
    ),
)
