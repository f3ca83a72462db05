"""Scenarios of joints in motion: pendula, chains and gyroscopes."""

from __future__ import annotations

import math
from collections.abc import Mapping
from functools import cache

import numpy as np
import torch

from orbit_conformance.bodies import WEIGHTLESS, G, body, pendulum, scene
from orbit_conformance.reference import FloatArray, PlanarChain, RotaryPendulum, pendulum_period, trajectory
from orbit_conformance.scenario import FIRST_ORDER, SINGLE, Metric, Scenario, Trial
from orbit_conformance.scenarios.free_motion import momenta
from orbit_core.dynamics.transforms import quat_rotate
from orbit_core.scene import Articulation, Box, Joint, JointType, Link, ObjectSpec, Pose, RobotSpec, Shape, single_link

_LENGTH = 0.5
# Amplitudes in rad; the period of the largest is more than twice that of the smallest.
_AMPLITUDES = (0.05, 1.5, 2.8)


def _pendulum(trial: Trial) -> Mapping[str, float]:
    """A pendulum released at rest, with one amplitude in each environment; it hangs down at a quarter turn."""
    world = trial.world(scene(pendulum(length=_LENGTH, links=1), terrain=()), num_envs=len(_AMPLITUDES))
    robot, chain = world.robots["pendulum"], PlanarChain(1, _LENGTH)
    lever = _LENGTH / 2
    small = 2 * math.pi * math.sqrt((chain.inertia + lever**2) / (G * lever))
    expected = [pendulum_period(amplitude, small) for amplitude in _AMPLITUDES]
    start = math.pi / 2 - torch.tensor(_AMPLITUDES)[:, None]
    robot.set_joint_state(start.to(world.device), torch.zeros_like(start).to(world.device))
    times, angles, speeds = [], [], []
    # Two periods of the largest amplitude, which is the slowest.
    for time in trial.advance(world, 2.0 * max(expected)):
        times.append(time)
        angles.append((robot.joint_positions[:, 0].double().cpu() - math.pi / 2).clone())
        speeds.append(robot.joint_velocities[:, 0].double().cpu().clone())
    angle, speed = torch.stack(angles), torch.stack(speeds)
    kinetic = 0.5 * (chain.inertia + lever**2) * speed**2
    energy = kinetic + G * lever * (1 - torch.cos(angle))
    drift = ((energy - energy[0]).abs() / energy[0]).max()
    shown = slice(None, None, max(1, trial.steps(0.02)))
    truth = trajectory(chain.derivative, np.array([float(start[-1]), 0.0]), times[shown], 4e-3)[:, 0] - math.pi / 2
    trial.trace("angle of the largest swing", "rad", times[shown], angle[shown, -1].tolist(), truth.tolist())
    periods = [_period(times, angle[:, i].tolist()) for i in range(len(_AMPLITUDES))]
    off = [abs(period / truth - 1) for period, truth in zip(periods, expected, strict=True)]
    return {"small_period": off[0], "large_period": max(off[1:]), "energy": float(drift)}


def _period(times: list[float], angles: list[float]) -> float:
    """Time between the first two passages through zero in the same direction, interpolated; NaN without two."""
    passages = [
        t + (u - t) * a / (a - b)
        for t, u, a, b in zip(times, times[1:], angles, angles[1:], strict=False)
        if a < 0 <= b
    ]  # fmt: skip
    return passages[1] - passages[0] if len(passages) > 1 else math.nan


# Angles in rad from the horizontal: the lower link goes over the top within two seconds.
_RELEASE = (0.3, 0.6)


@cache
def _double(times: tuple[float, ...]) -> FloatArray:
    return trajectory(PlanarChain(2, _LENGTH).derivative, np.array([*_RELEASE, 0.0, 0.0]), times)


def _double_pendulum(trial: Trial) -> Mapping[str, float]:
    world = trial.world(scene(pendulum(length=_LENGTH, links=2), terrain=()))
    robot, chain = world.robots["pendulum"], PlanarChain(2, _LENGTH)
    robot.set_joint_state(torch.tensor([_RELEASE], device=world.device))
    times, states = [], []
    for time in trial.advance(world, 2.0, every=0.02):
        times.append(time)
        states.append(torch.cat((robot.joint_positions[0], robot.joint_velocities[0])).tolist())
    truth, measured = _double(tuple(times)), np.array(states)
    trial.trace("angle of the lower hinge", "rad", times, measured[:, 1].tolist(), truth[:, 1].tolist())
    energies = np.array([chain.energy(state) for state in measured])
    # Energy is counted from hanging at rest, so that the relative error has a meaning.
    lowest = chain.energy(np.array([math.pi / 2, 0.0, 0.0, 0.0]))
    # The motion is chaotic: a small error grows tenfold in the second second.
    early = np.asarray(times) <= 1.0 + 1e-9
    apart = np.abs(measured[:, :2] - truth[:, :2]).max(-1)
    return {
        "first_second": float(apart[early].max()),
        "two_seconds": float(apart.max()),
        "energy": float(np.abs(energies - energies[0]).max() / (energies[0] - lowest)),
    }


_LINKS = 4


def _energy_of_a_chain(trial: Trial) -> Mapping[str, float]:
    """Four links let go level: their way is chaotic, their energy is not."""
    world = trial.world(scene(pendulum(length=_LENGTH, links=_LINKS), terrain=()))
    robot, chain = world.robots["pendulum"], PlanarChain(_LINKS, _LENGTH)
    lowest = chain.energy(np.array([math.pi / 2] + [0.0] * (2 * _LINKS - 1)))
    times, energies = [], []
    for time in trial.advance(world, 20.0, every=0.1):
        state = torch.cat((robot.joint_positions[0], robot.joint_velocities[0])).double().cpu().numpy()
        times.append(time)
        energies.append(chain.energy(state) - lowest)
    trial.trace("energy above hanging", "J", times, energies, [energies[0]] * len(times))
    shares = np.array(energies) / energies[0] - 1
    return {"gained": max(0.0, float(shares.max())), "lost": max(0.0, float(-shares.min()))}


_ARM, _LEVER, _ARM_INERTIA = 0.3, 0.25, 0.1
# Angle in rad from hanging at which the pendulum is released.
_UP = 2.5


def _furuta() -> RobotSpec:
    """An arm about z along x, and a pendulum about x at its end, which hangs at zero."""
    links = (
        body("base"),
        Link("arm", 1.0, (0.0, 0.0, 0.0), np.eye(3) * _ARM_INERTIA),
        body("pendulum", 1.0, (0.0, 0.0, -_LEVER), 0.01),
    )
    joints = (
        Joint("arm_hinge", JointType.CONTINUOUS, "base", "arm"),
        Joint("hinge", JointType.CONTINUOUS, "arm", "pendulum", Pose((_ARM, 0.0, 0.0)), axis=(1.0, 0.0, 0.0)),
    )
    return RobotSpec(name="furuta", articulation=Articulation("furuta", links, joints), fixed_base=True)


@cache
def _rotary(times: tuple[float, ...]) -> FloatArray:
    return trajectory(RotaryPendulum(_ARM, _LEVER, _ARM_INERTIA).derivative, np.array([0.0, _UP, 0.0, 0.0]), times)


def _rotary_pendulum(trial: Trial) -> Mapping[str, float]:
    world = trial.world(scene(_furuta(), terrain=()))
    robot, reference = world.robots["furuta"], RotaryPendulum(_ARM, _LEVER, _ARM_INERTIA)
    robot.set_joint_state(torch.tensor([[0.0, _UP]], device=world.device))
    times, states = [], []
    for time in trial.advance(world, 2.0, every=0.02):
        times.append(time)
        states.append(torch.cat((robot.joint_positions[0], robot.joint_velocities[0])).tolist())
    truth, measured = _rotary(tuple(times)), np.array(states)
    trial.trace("angle of the arm", "rad", times, measured[:, 0].tolist(), truth[:, 0].tolist())
    apart = np.abs(measured[:, :2] - truth[:, :2]).max(0)
    energies = np.array([reference.energy(state) for state in measured])
    return {
        "arm": float(apart[0]),
        "pendulum": float(apart[1]),
        "energy": float(np.abs(energies / energies[0] - 1).max()),
    }


# Spin in rad/s: 17 degrees in a millisecond.
SPIN = 300.0

# On gimbals ----------------------------------------------------------------------------------------------------------

_MASS, _RADIUS, _TOP_LEVER = 1.0, 0.1, 0.1
_AXIAL = 0.5 * _MASS * _RADIUS**2
_PRECESSION = _MASS * G * _TOP_LEVER / (_AXIAL * SPIN)


def _gyroscope() -> RobotSpec:
    """A disc on a level axle along x that turns on gimbals about z and y, 0.1 m aside of them."""
    # Gimbals as light as engines can bear, since the closed form has none.
    ring = np.eye(3) * 1e-4
    links = (
        Link("base", 1.0, (0.0, 0.0, 0.0), np.eye(3)),
        Link("outer", 0.01, (0.0, 0.0, 0.0), ring),
        Link("inner", 0.01, (0.0, 0.0, 0.0), ring),
        Link("disc", _MASS, (_TOP_LEVER, 0.0, 0.0), np.diag([_AXIAL, _AXIAL / 2, _AXIAL / 2])),
    )
    axes = {"yaw": (0.0, 0.0, 1.0), "pitch": (0.0, 1.0, 0.0), "spin": (1.0, 0.0, 0.0)}
    joints = tuple(
        Joint(name, JointType.CONTINUOUS, parent.name, child.name, axis=axis)
        for (name, axis), parent, child in zip(axes.items(), links, links[1:], strict=False)
    )
    return RobotSpec(name="gyroscope", articulation=Articulation("gyroscope", links, joints), fixed_base=True)


def _precession(trial: Trial) -> Mapping[str, float]:
    """Let go with the yaw rate of steady precession, at which a level axle stays level."""
    world = trial.world(scene(_gyroscope(), terrain=()))
    robot = world.robots["gyroscope"]
    robot.set_joint_state(velocities=torch.tensor([[_PRECESSION, 0.0, SPIN]], device=world.device))
    rate = level = spin = 0.0
    curve = []
    for time in trial.advance(world, 2.0, every=0.05):
        yaw, pitch, _ = robot.joint_positions[0].tolist()
        rate = max(rate, abs(yaw - _PRECESSION * time) / (2.0 * _PRECESSION))
        level = max(level, abs(pitch))
        spin = max(spin, abs(float(robot.joint_velocities[0, 2]) / SPIN - 1))
        curve.append((time, yaw, _PRECESSION * time))
    trial.trace("angle of precession", "rad", *zip(*curve, strict=True))
    return {"precession": rate, "level": level, "spin": spin}


# Free ----------------------------------------------------------------------------------------------------------------

_MOMENTS = {"round": (0.01, 0.01, 0.02), "asymmetric": (0.01, 0.02, 0.03)}
# Angular velocity in rad/s about a second axis, which makes the spin's axis go round.
_WOBBLE = 3.0


def _nutation(moments: tuple[float, float, float]) -> float:
    """The greatest angle of the third axis to L, in rad, that energy and momentum allow (the polhode's long axis).

    Of a body that starts with the wobble about its first axis.
    """
    a, b, c = moments
    second = _WOBBLE * math.sqrt(a * (c - a) / (b * (c - b)))
    return math.atan(max(a * _WOBBLE, b * second) / (c * SPIN))


def _free(name: str, moments: tuple[float, float, float], x: int) -> ObjectSpec:
    articulation = single_link(name, Shape(Box((0.05, 0.04, 0.03))), 1.0, np.diag(moments))
    return ObjectSpec(name=name, articulation=articulation, pose=Pose((float(x), 0.0, 0.0)))


def _fast_spin(trial: Trial) -> Mapping[str, float]:
    """A round body and an asymmetric one, each about its axis of largest moment, with a little about another."""
    things = [_free(name, moments, x) for x, (name, moments) in enumerate(_MOMENTS.items())]
    world = trial.world(scene(*things, gravity=WEIGHTLESS, terrain=()))
    start = torch.tensor([[0.0, 0.0, 0.0, _WOBBLE, 0.0, SPIN]], device=world.device)
    for thing in world.objects.values():
        thing.set_root_velocity(start)
    before = {name: momenta(thing) for name, thing in world.objects.items()}
    error = {"angular_momentum": 0.0, "energy": 0.0, "axis": 0.0}
    curve = []
    for time in trial.advance(world, 2.0, every=0.05):
        for name, thing in world.objects.items():
            now, then = momenta(thing), before[name]
            turned = float((now.angular - then.angular).norm() / then.angular.norm())
            error["angular_momentum"] = max(error["angular_momentum"], turned)
            error["energy"] = max(error["energy"], abs(float(now.energy / then.energy) - 1))
            axis = quat_rotate(thing.root_pose[0, 3:].cpu(), torch.tensor([0.0, 0.0, 1.0])).double()
            along = float(axis @ then.angular[0] / then.angular.norm())
            # The axis nutates within a known cone: only what goes beyond it is an error.
            beyond = math.acos(max(-1.0, min(1.0, along))) - _nutation(_MOMENTS[name])
            error["axis"] = max(error["axis"], beyond)
            if name == "asymmetric":
                curve.append((time, float(now.energy), float(then.energy)))
    trial.trace("energy of the asymmetric body", "J", *zip(*curve, strict=True))
    return error


SCENARIOS = (
    Scenario(
        name="pendulum",
        group="Joints in motion",
        question="Does a pendulum keep the time of its amplitude, and its energy?",
        truth="T = 4 sqrt(J / (m g r)) K(sin(amplitude / 2)), for amplitudes of 0.05, 1.5 and 2.8 rad",
        source="Landau and Lifshitz, Mechanics, 3rd ed., section 11, problem 1",
        run=_pendulum,
        metrics=(
            Metric(name="small_period", unit="", tolerance=1e-4, meaning="period of 0.05 rad, relative"),
            Metric(
                name="large_period",
                unit="",
                tolerance=1e-4,
                meaning="periods of 1.5 and 2.8 rad, relative, the worse",
                looser_because="the smallest error seen is luck: rounding and integration cancel",
            ),
            Metric(
                name="energy",
                unit="",
                tolerance=0.02,
                meaning="largest change over two periods, relative to the swing's",
            ),
        ),
    ),
    Scenario(
        name="double_pendulum",
        group="Joints in motion",
        question="Does a double pendulum go the way of its equations of motion?",
        truth="Lagrange's equations, integrated at 1 ms in double precision with fourth order",
        source="Landau and Lifshitz, Mechanics, 3rd ed., section 5, problem 1",
        run=_double_pendulum,
        metrics=(
            Metric(
                name="first_second", unit="rad", tolerance=0.25, meaning="largest error of an angle in the first second"
            ),
            Metric(name="two_seconds", unit="rad", tolerance=0.45, meaning="largest error of an angle in two seconds"),
            Metric(
                name="energy", unit="", tolerance=0.08, meaning="largest change, relative to that above hanging at rest"
            ),
        ),
    ),
    Scenario(
        name="energy_of_a_chain",
        group="Joints in motion",
        question="Does a chain of four links, which nothing drives or damps, keep its energy for 20 s?",
        truth="T + V is constant",
        source="Goldstein, Classical Mechanics, 3rd ed., section 1.2",
        run=_energy_of_a_chain,
        metrics=(
            Metric(
                name="gained", unit="", tolerance=0.05, meaning="largest gain, relative to that above hanging at rest"
            ),
            Metric(
                name="lost", unit="", tolerance=0.05, meaning="largest loss, relative to that above hanging at rest"
            ),
        ),
    ),
    Scenario(
        name="rotary_pendulum",
        group="Joints in motion",
        question="Does a pendulum on a turning arm (Furuta's) go the way of its equations of motion?",
        truth="Lagrange's equations, integrated at 1 ms in double precision with fourth order",
        source="Cazzolato and Prime, Journal of Control Science and Engineering 2011, article 528341",
        run=_rotary_pendulum,
        metrics=(
            Metric(name="arm", unit="rad", tolerance=0.4, meaning="largest error of the arm's angle in two seconds"),
            Metric(name="pendulum", unit="rad", tolerance=0.8, meaning="the same of the pendulum's"),
            Metric(name="energy", unit="", tolerance=0.07, meaning="largest change, relative"),
        ),
    ),
    Scenario(
        name="gyroscope",
        group="Joints in motion",
        question="Does a gyroscope at 300 rad/s stay up, and go round at the rate of steady precession?",
        truth="W = m g l / (I w) with the axle level, w constant",
        source="Goldstein, Classical Mechanics, 3rd ed., section 5.7 (a heavy symmetrical top, steady precession)",
        run=_precession,
        time_step=0.001,
        time_steps=(0.002, 0.001, 0.0005, 0.00025),
        metrics=(
            Metric(
                name="precession",
                unit="",
                tolerance=2e-4,
                meaning="largest error of the angle gone round within 2 s, over that after 2 s",
            ),
            Metric(name="level", unit="rad", tolerance=3.9e-4, meaning="largest angle of the axle to the level"),
            Metric(
                name="spin",
                unit="",
                tolerance=1e-5,
                meaning="largest change of the spin within 2 s, relative",
                looser_because=SINGLE,
            ),
        ),
    ),
    Scenario(
        name="fast_spin",
        group="Free motion",
        question="Does a free body that spins at 300 rad/s keep its momentum, its energy and its axis?",
        truth="L and T are constant; the axis of the largest moment stays within what T and L allow of L",
        source="Landau and Lifshitz, Mechanics, 3rd ed., sections 35 and 37",
        run=_fast_spin,
        metrics=(
            Metric(
                name="angular_momentum",
                unit="",
                tolerance=0.006,
                meaning="largest change within 2 s, relative",
                looser_because=FIRST_ORDER,
            ),
            Metric(
                name="energy", unit="", tolerance=2e-4, meaning="largest change of kinetic energy within 2 s, relative"
            ),
            Metric(
                name="axis",
                unit="rad",
                tolerance=1e-3,
                meaning="largest angle between the axis and L within 2 s, beyond what the polhode allows",
                looser_because="the best keeps within the polhode",
            ),
        ),
    ),
)
