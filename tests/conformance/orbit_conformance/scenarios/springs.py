"""Scenarios of joint stops and joint springs."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace

import torch

from orbit_conformance.bodies import WEIGHTLESS, G, rotor, scene, slider
from orbit_conformance.scenario import FIRST_ORDER, SINGLE, Metric, Scenario, Trial
from orbit_conformance.scenarios.joints import named
from orbit_core.interfaces import Capability
from orbit_core.scene import ActuatorConfig, ImplicitPd, JointType, Pose, RobotSpec

# rad; rad/s.
_LIMIT, _SPEED = 1.0, 20.0
# The parts of a time step by which the impacts differ.
_PHASES = 5
# Stiffness, damping and target of the drive that pushes against the limit: 100 N m at rest.
_PUSH = (200.0, 20.0, 1.5)


def _stopped(name: str, actuators: tuple[ActuatorConfig, ...] = ()) -> RobotSpec:
    """A rotor of 0.1 kg m^2 between two limits."""
    robot = rotor(inertia=0.1, actuators=actuators)
    joint = robot.articulation.joints[0]
    joint = replace(joint, type=JointType.REVOLUTE, lower_limit=-_LIMIT, upper_limit=_LIMIT)
    return named(name, replace(robot, articulation=replace(robot.articulation, joints=(joint,))))


def _run_into(trial: Trial) -> Mapping[str, float]:
    """Rotors meet their limit early and late in a step; one is pushed against it."""
    stiffness, damping, target = _PUSH
    pushing = ImplicitPd(joints=(".*",), stiffness=stiffness, damping=damping)
    free = [f"free{number}" for number in range(_PHASES)]
    robots = (*(_stopped(name) for name in free), _stopped("pushed", (pushing,)))
    world = trial.world(scene(*robots, gravity=WEIGHTLESS, terrain=()))
    way = _SPEED * trial.time_step
    for number, name in enumerate(free):
        start = 0.5 * _LIMIT + way * number / _PHASES
        placed, moving = (torch.full((1, 1), value, device=world.device) for value in (start, _SPEED))
        world.robots[name].set_joint_state(placed, moving)
    world.robots["pushed"].set_position_targets(torch.full((1, 1), target, device=world.device))
    passed = back = 0.0
    times: list[float] = []
    angles: list[float] = []
    for time in trial.advance(world, 0.5):
        for name in free:
            robot = world.robots[name]
            passed = max(passed, float(robot.joint_positions[0, 0]) - _LIMIT)
            back = max(back, -float(robot.joint_velocities[0, 0]))
        times.append(time)
        angles.append(float(world.robots[free[0]].joint_positions[0, 0]))
    truth = [min(_LIMIT, 0.5 * _LIMIT + _SPEED * time) for time in times]
    trial.trace("angle of a joint that meets its limit", "rad", times, angles, truth)
    held = float(world.robots["pushed"].joint_positions[0, 0]) - _LIMIT
    return {"passed": passed, "rebound": back / _SPEED, "held": abs(held)}


_MASS, _REST, _START = 2.0, 0.1, 0.4
# Angular frequency in rad/s of the free oscillation.
_OMEGA = 2 * math.pi


def _springs(trial: Trial) -> Mapping[str, float]:
    return {**_oscillation(trial), **_equilibria(trial)}


def _oscillation(trial: Trial) -> dict[str, float]:
    """A mass on a spring, let go: ``q = rest + (start - rest) cos(omega t)``."""
    robot = slider(mass=_MASS, stiffness=_MASS * _OMEGA**2, rest_position=_REST)
    world = trial.world(scene(robot, gravity=WEIGHTLESS, terrain=()))
    slid, range_ = world.robots["slider"], _START - _REST
    slid.set_joint_state(torch.tensor([[_START]], device=world.device))
    before, passages, curve = range_, [], []
    for time in trial.advance(world, 3.0):
        now = float(slid.joint_positions[0, 0]) - _REST
        if before > 0 >= now:
            passages.append(time - trial.time_step * now / (now - before))
        before = now
        curve.append((time, now + _REST, _REST + range_ * math.cos(_OMEGA * time)))
    trial.trace("position of a mass on a spring", "m", *zip(*curve, strict=True))
    period = (passages[2] - passages[0]) / 2 if len(passages) > 2 else math.nan
    last = max(abs(position - _REST) for time, position, _ in curve if time > 2.0)
    return {"period": abs(period * _OMEGA / (2 * math.pi) - 1), "amplitude": abs(last / range_ - 1)}


def _hanging(name: str, stiffness: float, home: float = 0.0, actuators: tuple[ActuatorConfig, ...] = ()) -> RobotSpec:
    """A damped slider that points down."""
    down = Pose.from_axis_angle((0.0, 1.0, 0.0), math.pi / 2)
    robot = slider(mass=_MASS, stiffness=stiffness, rest_position=_REST, damping=40.0)
    return RobotSpec(
        name=name,
        articulation=robot.articulation,
        fixed_base=True,
        pose=down,
        actuators=actuators,
        home={"slide": home},
    )


def _equilibria(trial: Trial) -> dict[str, float]:
    """Return errors of springs in balance with weight: alone, with a drive, with one at its limit; and of a stiff
    spring that is released where it pulls nothing."""
    soft, stiff, gain, target, limit, weight = 500.0, 2e6, 1500.0, 0.3, 5.0, _MASS * G
    drive = ImplicitPd(joints=(".*",), stiffness=gain, damping=20.0)
    weak = ImplicitPd(joints=(".*",), stiffness=gain, damping=20.0, effort_limit=limit)
    # Springs alone and in company: an engine may add a drive's stiffness to the spring's, or replace it.
    cases = {
        "alone": (_hanging("alone", soft), _REST + weight / soft),
        "driven": (
            _hanging("driven", soft, actuators=(drive,)),
            (soft * _REST + gain * target + weight) / (soft + gain),
        ),
        "limited": (_hanging("limited", soft, actuators=(weak,)), _REST + (weight + limit) / soft),
        "stiff": (_hanging("stiff", stiff, home=_REST), _REST + weight / stiff),
    }
    world = trial.world(scene(*(robot for robot, _ in cases.values()), terrain=()))
    for name, (_, truth) in cases.items():
        if name != "stiff":
            world.robots[name].set_joint_state(torch.tensor([[truth]], device=world.device))
    for name in ("driven", "limited"):
        world.robots[name].set_position_targets(torch.tensor([[target]], device=world.device))
    off = dict.fromkeys(cases, 0.0)
    for time in trial.advance(world, 1.5):
        for name, (_, truth) in cases.items():
            if name != "stiff" or time > 1.0:
                off[name] = max(off[name], abs(float(world.robots[name].joint_positions[0, 0]) - truth))
    return {
        "sag": max(off["alone"], off["limited"]) / (weight / soft),
        "driven": off["driven"] / (target - _REST),
        "stiff": off["stiff"],
    }


SCENARIOS = (
    Scenario(
        name="joint_stops",
        group="Joints",
        question="Do joint limits stop a fast joint where they are, take its speed, and hold against a strong drive?",
        truth="q <= limit; rest after the impact; rest at the limit under a drive beyond it",
        source="the contract: limits are inelastic stops",
        run=_run_into,
        needs=(Capability.ARTICULATIONS, Capability.IMPLICIT_DRIVES),
        metrics=(
            Metric(
                name="passed",
                unit="rad",
                tolerance=1e-5,
                looser_because=SINGLE,
                meaning="largest angle beyond the limit, at 20 rad/s, over impacts early and late in a step",
            ),
            Metric(
                name="rebound",
                unit="",
                tolerance=1e-5,
                looser_because=SINGLE,
                meaning="largest speed away from the limit, relative to that of the impact",
            ),
            Metric(
                name="held",
                unit="rad",
                tolerance=1e-3,
                meaning="angle beyond the limit under 100 N m at rest",
                looser_because="a thousandth of a radian is less than the play of hinges",
            ),
        ),
    ),
    Scenario(
        name="joint_springs",
        group="Joints",
        question="Does a joint's own spring swing, sag, and share the load with a drive as it should?",
        truth="q = r + (q0 - r) cos(sqrt(k/m) t); k (q - r) = m g + drive",
        source="Landau and Lifshitz, Mechanics, 3rd ed., section 21",
        judges=(Capability.JOINT_SPRINGS,),
        needs=(Capability.JOINT_SPRINGS,),
        run=_springs,
        metrics=(
            Metric(
                name="period",
                unit="",
                tolerance=2e-4,
                meaning="of a mass on a spring at 1 Hz, relative",
                looser_because=FIRST_ORDER,
            ),
            Metric(
                name="amplitude",
                unit="",
                tolerance=1e-3,
                meaning="change of the swing in its third second, relative",
                looser_because=FIRST_ORDER,
            ),
            Metric(
                name="sag",
                unit="",
                tolerance=1e-3,
                meaning="how far it strays from the sag under weight, alone and beside a drive at its limit, relative",
                looser_because="a thousandth of a deflection is less than springs are wound to",
            ),
            Metric(
                name="driven",
                unit="",
                tolerance=1e-3,
                meaning="how far it strays from balance with a drive, relative to the distance of their targets",
                looser_because="a thousandth of a deflection is less than springs are wound to",
            ),
            Metric(
                name="stiff",
                unit="m",
                tolerance=1e-4,
                meaning="position of a mass on a spring of 5 rad of natural frequency per step",
                looser_because="a tenth of a millimetre is a position that came to rest",
            ),
        ),
    ),
)
