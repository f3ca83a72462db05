"""Scenarios of close fits: rings on rods, pegs that jam or wedge, rods between fingers, and screws."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace

import numpy as np
import torch

from orbit_assets.objects import box, cylinder
from orbit_assets.pegs import ring_on_handle
from orbit_assets.threads import Thread, bolt_boxes, nut_boxes
from orbit_conformance.bodies import (
    SMOOTH,
    SMOOTH_GROUND,
    WEIGHTLESS,
    G,
    body,
    contact_sensor,
    fixed,
    scene,
    smooth_material,
)
from orbit_conformance.scenario import Metric, Scenario, Trial
from orbit_core.dynamics.transforms import rotation_angle, yaw_angle
from orbit_core.interfaces import Capability
from orbit_core.scene import (
    Articulation,
    Box,
    Capsule,
    ContactSensorSpec,
    ImplicitPd,
    Joint,
    JointType,
    Link,
    ObjectSpec,
    Pose,
    RobotSpec,
    Shape,
    Sphere,
)

_RING_ROD, _BAR, _RADIUS, _REACH = 0.006, 0.004, 0.035, 0.14
# Metres between the rod and the ring's bar at first, such that they meet at different times within a step.
_STARTS = (1.0e-3, 1.53e-3, 2.06e-3, 2.59e-3)
# m/s: a tenth of a millimetre in a step.
_RING_SPEED = 0.02


def _ring_on_rod(trial: Trial) -> Mapping[str, float]:
    """A weightless ring goes slowly towards the rod in it, until a sensor reports force between them."""
    ring = ObjectSpec(name="ring", articulation=ring_on_handle("ring", _RADIUS, _BAR, _REACH))
    rod = fixed("rod", Capsule(_RING_ROD, 0.2), Pose.from_axis_angle((1.0, 0.0, 0.0), 0.5 * math.pi))
    sensor = ContactSensorSpec(name="touch", entity="ring", filters=("rod",))
    world = trial.world(scene(ring, rod, sensors=(sensor,), terrain=(), gravity=WEIGHTLESS), len(_STARTS))
    body, starts = world.objects["ring"], torch.tensor(_STARTS, device=world.device)
    # The joint of two bars that is nearest to the handle comes from below to the rod, whose axis is at z = 0.
    meeting = -(_REACH - _RADIUS) - _BAR - _RING_ROD
    pose, velocity = (
        torch.zeros(len(_STARTS), 7, device=world.device),
        torch.zeros(len(_STARTS), 6, device=world.device),
    )
    pose[:, 2], pose[:, 3], velocity[:, 2] = meeting - starts, 1.0, _RING_SPEED
    body.set_root_pose(pose)
    body.set_root_velocity(velocity)
    gaps = torch.full_like(starts, torch.nan)
    for _ in trial.advance(world, 0.25):
        forces = contact_sensor(world, "touch").filtered_forces.flatten(1).norm(dim=1)
        gaps = torch.where((forces > 1e-6) & gaps.isnan(), meeting - body.root_pose[:, 2], gaps)
    gaps = gaps.nan_to_num(-_RING_SPEED * 0.25)
    return {"early": max(0.0, float(gaps.max())), "late": max(0.0, -float(gaps.min()))}


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


_WEDGED_WIDTH, _WEDGED_LENGTH, _WEDGED_MU, _WEDGED_SQUEEZE, _STIFFNESS, _TIP = 0.05, 0.1, 0.4, 5.0, 1e3, 0.01
# Heights of the right point over the left one's, over friction times the peg's width: below 1 the peg is wedged.
_DEPTHS = (0.5, 0.8, 0.9, 1.1, 1.2, 1.5)
# Pulls at the first peg over the greatest that holds: one to each environment.
_PULLS = (0.0, 0.5, 0.8, 0.9, 1.1, 1.2, 1.5)
# Metres between pegs; the turn (rad) by which a peg counts as let go, and the way (m) by which the first does. One
# that goes turns until the line between the points lies in the cones: at 1.1 it swings to 0.06 rad.
_APART, _TURNED, _MOVED = 0.2, 0.04, 0.001


def _points() -> RobotSpec:
    """Build for each peg a ball on its left side, and one on its right that a force presses on along x."""
    tip = Shape(Sphere(_TIP), material=smooth_material(_WEDGED_MU))
    inertia, reach = np.eye(3) * 0.01, 0.5 * _WEDGED_WIDTH + _TIP
    links, joints = [body("base")], list[Joint]()
    for number, depth in enumerate(_DEPTHS):
        for side in (-1.0, 1.0):
            name = f"{'left' if side < 0.0 else 'right'}{number}"
            links.append(Link(name, 1.0, (0.0, 0.0, 0.0), inertia, (tip,), (tip,)))
            place = Pose((side * reach, _APART * number, 0.5 * side * depth * _WEDGED_MU * _WEDGED_WIDTH))
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
    material = smooth_material(_WEDGED_MU)
    pegs = [
        box(
            f"peg{number}",
            (_WEDGED_WIDTH, 0.05, _WEDGED_LENGTH),
            mass=1.0,
            material=material,
            pose=Pose((0.0, _APART * number, 0.0)),
        )
        for number in range(len(_DEPTHS))
    ]
    world = trial.world(scene(_points(), *pegs, terrain=(), gravity=WEIGHTLESS), len(_PULLS))
    robot, things = world.robots["points"], list(world.objects.values())
    robot.set_position_targets(torch.full_like(robot.joint_positions, -_WEDGED_SQUEEZE / _STIFFNESS))
    pulls = torch.tensor(_PULLS, device=world.device)
    force = torch.zeros(len(_PULLS), 1, 6, device=world.device)

    def advance(seconds: float) -> None:
        for _ in range(trial.steps(seconds)):
            things[0].set_wrenches(force)
            trial.step(world, 1)

    advance(0.2)
    before = torch.stack([thing.root_pose for thing in things], dim=1).clone()
    force[:, 0, 2] = 2.0 * _WEDGED_MU * _WEDGED_SQUEEZE * (1.0 - _DEPTHS[0]) * pulls
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


_THREAD = Thread(radius=0.03, lead=0.008)
_NUT_LENGTH, _HEIGHT, _NUT_CLEARANCE = 0.05, 0.02, 2e-4
_MASS, _INERTIA = 1.0, 1e-3


def _screw(trial: Trial) -> Mapping[str, float]:
    """Threads of boxes, which every engine has as they are; all of the nut is on the bolt from the start."""
    rod = bolt_boxes(_NUT_LENGTH, _THREAD, SMOOTH)
    ring = nut_boxes(_HEIGHT, _THREAD.radius + 0.01, _THREAD, SMOOTH, clearance=_NUT_CLEARANCE)
    fixed = Link("bolt", 1.0, (0.0, 0.0, 0.0), np.eye(3), rod, rod)
    moving = Link("nut", _MASS, (0.0, 0.0, 0.5 * _HEIGHT), _INERTIA * np.eye(3), ring, ring)
    bolt = ObjectSpec(name="bolt", articulation=Articulation("bolt", (fixed,)), fixed_base=True)
    start = Pose((0.0, 0.0, _NUT_LENGTH - _THREAD.lead - _HEIGHT))
    nut = ObjectSpec(name="nut", articulation=Articulation("nut", (moving,)), pose=start)
    world = trial.world(scene(bolt, nut, terrain=()))
    thing = world.objects["nut"]
    rise = _THREAD.lead / (2.0 * math.pi)
    pace = _MASS * G * rise / (_INERTIA + _MASS * rise**2)
    turned, last, curve = 0.0, 0.0, []
    for time in trial.advance(world, 0.9, every=0.02):
        angle = float(yaw_angle(thing.root_pose[0, 3:]))
        turned += math.remainder(angle - last, 2.0 * math.pi)
        last = angle
        curve.append((time, -turned, 0.5 * pace * time**2, float(thing.root_pose[0, 2])))
    times, angles, truth, heights = zip(*curve, strict=True)
    trial.trace("turn", "rad", times, angles, truth)
    early = 12  # by then it rests on the bolt's flanks
    fallen, turns = heights[early] - heights[-1], (angles[-1] - angles[early]) / (2.0 * math.pi)
    share = math.sqrt(max(angles[-1], 0.0) / truth[-1])
    return {"lead": abs(fallen / max(turns, 1e-9) / _THREAD.lead - 1.0), "pace": abs(share - 1.0)}


SCENARIOS = (
    Scenario(
        name="ring_on_rod",
        group="Contact",
        question="Does a ring around a rod touch it where their surfaces meet, and not before?",
        truth="force from where the gap between their surfaces is zero, at 0.02 m/s",
        source="the geometry of two capsules: the distance of their axes less both radii",
        judges=(Capability.CONTACT_FORCES,),
        run=_ring_on_rod,
        metrics=(
            Metric(
                name="early",
                unit="m",
                tolerance=1.5e-4,
                meaning="largest gap at the end of the first step in which there is a force",
                looser_because="a step and a half of the way; engines that wait for an overlap are never early",
            ),
            Metric(
                name="late",
                unit="m",
                tolerance=2e-4,
                meaning="deepest overlap then; 5 mm where there never is a force",
                looser_because="two steps of the way; engines that foresee the contact are never late",
            ),
        ),
    ),
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
    Scenario(
        name="screw",
        group="Contact",
        question="Does a nut go down its bolt by the lead in each turn, as fast as its weight turns it?",
        truth="z = -lead t / 2 pi; t'' = m g p / (I + m p^2), p = lead / 2 pi",
        source="Shigley's Mechanical Engineering Design, 10th ed., section 8-2, without friction",
        judges=(),
        run=_screw,
        metrics=(
            Metric(
                name="lead",
                unit="",
                tolerance=0.015,
                meaning="relative error of the way that it falls in a turn",
                looser_because="boxes along a helix are flat: their flanks stray from it by 12 micrometres",
            ),
            Metric(
                name="pace",
                unit="",
                tolerance=0.05,
                meaning="relative error of the square root of the angle at the end",
                looser_because="it drops by 0.2 mm of play until flanks meet, and hits edges of boxes as it turns",
            ),
        ),
    ),
)
