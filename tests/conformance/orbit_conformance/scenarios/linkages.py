"""Joints that are coupled: by gears, and by loops."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace

import numpy as np
import torch

from orbit_conformance.bodies import WEIGHTLESS, G, body, geared, scene
from orbit_conformance.reference import FloatArray, pendulum_period
from orbit_conformance.scenario import FIRST_ORDER, SINGLE, Metric, Scenario, Trial
from orbit_core.interfaces import Capability, Object
from orbit_core.scene import (
    ActuatorConfig,
    Articulation,
    ForceTorqueSpec,
    IdealPd,
    ImplicitPd,
    Joint,
    JointType,
    LoopJoint,
    Pose,
    RobotSpec,
)
from orbit_core.sensors.proprioception import ForceTorqueSensor

# Mimic joints --------------------------------------------------------------------------------------------------------

_MOTOR = (IdealPd(joints=(".*",)),)


def _nested(multiplier: float) -> RobotSpec:
    """Two balanced rotors; the second hangs on the first and mimics it."""
    robot = geared(multiplier, 0.0, _MOTOR)
    leader, follower = robot.articulation.joints
    joints = (leader, replace(follower, parent="first"))
    return replace(robot, name="nested", articulation=replace(robot.articulation, joints=joints))


def _mimic(trial: Trial) -> Mapping[str, float]:
    """Leaders pushed to and fro carry the inertia of their followers, geared."""
    offset, effort, omega, inertia = 0.1, 4.0, 2 * math.pi, 0.1
    robots = (geared(-2.0, offset, _MOTOR), _nested(0.5))
    world = trial.world(scene(*robots, gravity=WEIGHTLESS, terrain=()))
    cases = (("nested", 0.5, 0.0, inertia * (1 + 1.5**2)), ("geared", -2.0, offset, inertia * (1 + 2.0**2)))
    coupling = motion = 0.0
    curve = []
    for time in trial.advance(world, 2.0):
        held = effort * math.cos(omega * (time + 0.5 * trial.time_step))  # for the step to come
        for name, multiplier, aside, total in cases:
            robot = world.robots[name]
            leader, follower = robot.joint_positions[0].tolist()
            half = effort / total / omega**2
            truth = half * (1 - math.cos(omega * time))
            coupling = max(coupling, abs(follower - multiplier * leader - aside) / (2 * half))
            motion = max(motion, abs(leader - truth) / (2 * half))
            robot.set_effort_targets(torch.tensor([[held, 0.0]], device=world.device))
            if name == "geared":
                curve.append((time, leader, truth))
    trial.trace("angle of a leader", "rad", *zip(*curve, strict=True))
    return {"coupling": coupling, "motion": motion, "driven": _driven_coupling(trial)}


def _driven_coupling(trial: Trial) -> float:
    """Largest error of the follower while a stiff drive steps its leader, as the motor of a gripper does."""
    multiplier, target = -1.0, 0.8
    motor = (ImplicitPd(joints=("leader",), stiffness=1000.0, damping=100.0),)
    world = trial.world(scene(geared(multiplier, 0.0, motor), gravity=WEIGHTLESS, terrain=()))
    robot = world.robots["geared"]
    robot.set_position_targets(torch.tensor([[target, 0.0]], device=world.device))
    error, curve = 0.0, []
    for time in trial.advance(world, 0.5):
        leader, follower = robot.joint_positions[0].tolist()
        error = max(error, abs(follower - multiplier * leader))
        curve.append((time, follower, multiplier * leader))
    trial.trace("angle of the follower of a driven leader", "rad", *zip(*curve, strict=True))
    return error / target


# Loops ----------------------------------------------------------------------------------------------------------------

_HINGES: tuple[str, ...] = ("crank_hinge", "coupler_hinge", "rocker_hinge")


def four_bar(
    name: str,
    lengths: tuple[float, float, float, float],
    start: tuple[float, float, float],
    actuators: tuple[ActuatorConfig, ...] = (),
) -> RobotSpec:
    """Ground, crank, coupler and rocker in the plane of x and z; each link 1 kg, its centre halfway.

    The crank turns about the origin, the rocker about (ground, 0, 0); angles rise from x towards z.
    """
    ground, crank, coupler, rocker = lengths
    links = [body("base")]
    links += [
        body(part, 1.0, (length / 2, 0.0, 0.0), length**2 / 12)
        for part, length in (("crank", crank), ("coupler", coupler), ("rocker", rocker))
    ]
    hinge = {"type": JointType.CONTINUOUS, "axis": (0.0, -1.0, 0.0)}
    joints = (
        Joint(name=_HINGES[0], parent="base", child="crank", **hinge),
        Joint(name=_HINGES[1], parent="crank", child="coupler", parent_pose=Pose((crank, 0.0, 0.0)), **hinge),
        Joint(name=_HINGES[2], parent="base", child="rocker", parent_pose=Pose((ground, 0.0, 0.0)), **hinge),
    )
    loop = LoopJoint("knee", "coupler", "rocker", (coupler, 0.0, 0.0), (rocker, 0.0, 0.0))
    articulation = Articulation(name, tuple(links), joints, loops=(loop,))
    home: dict[str, float] = dict(zip(_HINGES, start, strict=True))
    return RobotSpec(name=name, articulation=articulation, fixed_base=True, home=home, actuators=actuators)


def _rocker_angle(lengths: tuple[float, float, float, float], crank_angle: float) -> float:
    """Freudenstein's equation, ``K1 cos(r) - K2 cos(c) + K3 = cos(c - r)``, solved for the open circuit."""
    ground, crank, coupler, rocker = lengths
    k1, k2 = ground / crank, ground / rocker
    k3 = (ground**2 + crank**2 - coupler**2 + rocker**2) / (2 * crank * rocker)
    cosine, sine = math.cos(crank_angle), math.sin(crank_angle)
    a, b, c = cosine - k1 - k2 * cosine + k3, -2 * sine, k1 - (k2 + 1) * cosine + k3
    return 2 * math.atan2(-b - math.sqrt(b * b - 4 * a * c), 2 * a)


def _positions(lengths: tuple[float, float, float, float], crank_angle: float) -> tuple[float, float, float]:
    """Positions of the three hinges."""
    ground, crank, _, rocker = lengths
    angle = _rocker_angle(lengths, crank_angle)
    x = ground + rocker * math.cos(angle) - crank * math.cos(crank_angle)
    z = rocker * math.sin(angle) - crank * math.sin(crank_angle)
    return crank_angle, math.atan2(z, x) - crank_angle, angle


def _opening(robot: Object, lengths: tuple[float, float, float, float]) -> float:
    """Distance in metres between the ends of coupler and rocker."""
    crank, elbow, rocker = robot.joint_positions[0].tolist()
    x = lengths[1] * math.cos(crank) + lengths[2] * math.cos(crank + elbow) - lengths[0] - lengths[3] * math.cos(rocker)
    z = lengths[1] * math.sin(crank) + lengths[2] * math.sin(crank + elbow) - lengths[3] * math.sin(rocker)
    return math.hypot(x, z)


_CRANK_ROCKER = (0.3, 0.1, 0.3, 0.25)
PARALLELOGRAM = (0.4, 0.2, 0.4, 0.2)
_SWING = 0.5
"""Angle in rad from hanging."""


def _four_bar_linkage(trial: Trial) -> Mapping[str, float]:
    motor = (ImplicitPd(joints=("crank_hinge",), damping=20.0),)
    world = trial.world(scene(four_bar("driven", _CRANK_ROCKER, _positions(_CRANK_ROCKER, 1.0), motor), terrain=()))
    robot = world.robots["driven"]
    robot.set_velocity_targets(torch.tensor([[2 * math.pi, 0.0, 0.0]], device=world.device))
    angle = opening = 0.0
    curve = []
    for time in trial.advance(world, 2.0, every=0.02):
        crank, _, rocker = robot.joint_positions[0].tolist()
        truth = _rocker_angle(_CRANK_ROCKER, crank)
        angle = max(angle, abs(math.remainder(rocker - truth, 2 * math.pi)))
        opening = max(opening, _opening(robot, _CRANK_ROCKER))
        curve.append((time, rocker, rocker - math.remainder(rocker - truth, 2 * math.pi)))
    trial.trace("angle of the rocker", "rad", *zip(*curve, strict=True))
    period, opened = _swinging_period(trial)
    return {"rocker": angle, "opening": max(opening, opened), "period": period}


def _swinging_period(trial: Trial) -> tuple[float, float]:
    """A parallelogram swings as one pendulum: its coupler does not turn. Relative error of the period, and opening."""
    start = -math.pi / 2 + _SWING
    world = trial.world(scene(four_bar("swinging", PARALLELOGRAM, (start, -start, start)), terrain=()))
    robot, length = world.robots["swinging"], PARALLELOGRAM[1]
    inertia = 2 * length**2 / 3 + length**2  # two uniform bars about their ends, and the coupler at theirs
    torque = G * (2 * length / 2 + length)
    expected = pendulum_period(_SWING, 2 * math.pi * math.sqrt(inertia / torque))
    passages: list[float] = []
    before, opening = _SWING, 0.0
    for time in trial.advance(world, 1.5 * expected):
        now = float(robot.joint_positions[0, 0]) + math.pi / 2
        if before < 0 <= now or now < 0 <= before:
            passages.append(time - trial.time_step * now / (now - before))
        before = now
        opening = max(opening, _opening(robot, PARALLELOGRAM))
    period = passages[2] - passages[0] if len(passages) > 2 else math.nan
    return abs(period / expected - 1), opening


_PARALLELOGRAM = (0.4, 0.3, 0.4, 0.3)
_STANDING = 0.5
"""Angle of the crank, rad."""


def _wrenches_in_a_loop(trial: Trial) -> Mapping[str, float]:
    """A drive holds a parallelogram up, then swings it; free hinges transmit forces and no torque about their axis."""
    drive = ImplicitPd(joints=("crank_hinge",), stiffness=2000.0, damping=100.0)
    robot = four_bar("parallelogram", _PARALLELOGRAM, (_STANDING, -_STANDING, _STANDING), (drive,))
    links = ("crank", "coupler", "rocker")
    sensors = tuple(ForceTorqueSpec(name=link, entity=robot.name, link=link) for link in links)
    world = trial.world(scene(robot, sensors=sensors, terrain=()))
    mechanism = world.robots[robot.name]
    hinge = mechanism.joint_names.index("crank_hinge")

    def measured() -> FloatArray:
        """(links, 6)"""
        meters = [world.sensors[link] for link in links]
        return np.array([meter.wrench[0].tolist() for meter in meters if isinstance(meter, ForceTorqueSensor)])

    def drive_to(angle: float) -> None:
        mechanism.set_position_targets(torch.full((1, 1), angle, device=world.device), [hinge])

    drive_to(_STANDING)
    trial.step(world, trial.steps(1.5))
    truth, wrenches = _parallelogram_at_rest(float(mechanism.joint_positions[0, hinge])), measured()
    drive_to(_STANDING + 0.5)
    loose, largest = 0.0, 0.0
    for _ in trial.advance(world, 0.5):
        torques = -measured()[:, 4]  # hinges turn about -y
        effort = float(mechanism.joint_efforts[0, hinge])
        loose = max(loose, *np.abs(torques - (effort, 0.0, 0.0)).tolist())
        largest = max(largest, abs(effort))
    return {
        "force": float(np.abs(wrenches - truth)[:, :3].max()),
        "torque": float(np.abs(wrenches - truth)[:, 3:].max()),
        "swinging": loose / largest,
    }


def _parallelogram_at_rest(angle: float) -> FloatArray:
    """(3, 6) wrenches that crank, coupler and rocker receive, about their hinges in their axes.

    The knee carries half of the coupler's weight, and as much along the ground as keeps the rocker, free to turn, from
    falling; the crank carries the rest.
    """
    crank, weight = _PARALLELOGRAM[1], G
    cosine, sine = math.cos(angle), math.sin(angle)
    along = weight * cosine / sine  # of the rocker on the coupler; moments about the rocker's hinge
    coupler = (-along, 0.5 * weight)
    held = (-along, 1.5 * weight), coupler, (along, 1.5 * weight)
    turned = [(cosine * x + sine * z, cosine * z - sine * x) for x, z in (held[0], held[2])]
    effort = 2.0 * weight * crank * cosine
    forces = (turned[0], coupler, turned[1])
    return np.array([[x, 0.0, z, 0.0, -about, 0.0] for (x, z), about in zip(forces, (effort, 0.0, 0.0), strict=True)])


SCENARIOS = (
    Scenario(
        name="mimic_joints",
        group="Joints",
        question="Does a mimic joint follow its leader and load it with its inertia?",
        truth="q2 = m q1 + c; (I1 + m^2 I2) a1 = tau, with m + 1 for m where the follower hangs on its leader",
        source="Landau and Lifshitz, Mechanics, 3rd ed., sections 2 and 38 (holonomic constraints)",
        judges=(Capability.MIMIC_JOINTS,),
        run=_mimic,
        metrics=(
            Metric(
                name="coupling",
                unit="",
                tolerance=2.5e-4,
                meaning="largest error of q2, relative to q1's range",
                looser_because="a coupling that gives a four-thousandth way moves as a rigid one",
            ),
            Metric(
                name="driven",
                unit="",
                tolerance=2e-3,
                meaning="largest error of q2 while a stiff drive steps q1, relative to the step",
                looser_because="couplings that are stiff springs give way for a moment",
            ),
            Metric(name="motion", unit="", tolerance=0.01, meaning="largest error of q1, relative to its range"),
        ),
    ),
    Scenario(
        name="four_bar_linkage",
        group="Joints",
        question="Does a loop stay closed, and move as its geometry and its inertia say?",
        truth="Freudenstein's equation for a crank and rocker; a parallelogram swings as a pendulum",
        source="Freudenstein, Transactions of the ASME 77, 1955, p. 853; Norton, Design of Machinery, section 4.5",
        judges=(Capability.LOOP_JOINTS,),
        run=_four_bar_linkage,
        needs=(Capability.LOOP_JOINTS,),
        metrics=(
            Metric(
                name="rocker",
                unit="rad",
                tolerance=1e-3,
                meaning="largest error of the rocker's angle, at one turn a second",
                looser_because="a thousandth of a radian is less than the play of hinges",
            ),
            Metric(
                name="opening",
                unit="m",
                tolerance=2e-4,
                meaning="largest distance between the loop's ends",
                looser_because="a fifth of a millimetre is less than the play of hinges",
            ),
            Metric(
                name="period",
                unit="",
                tolerance=2e-4,
                meaning="of the parallelogram's swing of 0.5 rad, relative",
                looser_because=SINGLE,
            ),
        ),
    ),
    Scenario(
        name="wrenches_in_a_loop",
        group="Joints",
        question="Do the wrenches of a closed linkage's joints hold what the loop transmits?",
        truth="statics of a parallelogram; a free hinge transmits no torque about its axis, a driven one its effort",
        source="Meriam and Kraige, Engineering Mechanics: Statics, section 4/6",
        judges=(Capability.LOOP_WRENCHES,),
        run=_wrenches_in_a_loop,
        needs=(Capability.LOOP_JOINTS, Capability.LOOP_WRENCHES, Capability.IMPLICIT_DRIVES),
        metrics=(
            Metric(
                name="force",
                unit="N",
                tolerance=0.02,
                meaning="largest error of a force at rest, of up to 24 N",
                looser_because=SINGLE,
            ),
            Metric(
                name="torque",
                unit="N m",
                tolerance=5e-3,
                meaning="largest error of a torque at rest, of up to 5 N m",
                looser_because=SINGLE,
            ),
            Metric(
                name="swinging",
                unit="",
                tolerance=0.03,
                meaning="largest torque about a free hinge, or beyond the effort, while it swings; relative",
                looser_because=FIRST_ORDER,
            ),
        ),
    ),
)
