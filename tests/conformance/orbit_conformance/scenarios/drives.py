"""Scenarios of drives: their response to targets, and the efforts that they report."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np
import torch

from orbit_conformance.bodies import WEIGHTLESS, pendulum, rotor, scene, slider
from orbit_conformance.reference import PlanarChain, linear_response
from orbit_conformance.scenario import FIRST_ORDER, SINGLE, Metric, Scenario, Trial
from orbit_conformance.scenarios.joints import named
from orbit_core.interfaces import Capability, World
from orbit_core.scene import ActuatorConfig, ForceTorqueSpec, IdealPd, ImplicitPd, RobotSpec
from orbit_core.sensors.proprioception import ForceTorqueSensor

_INERTIA, _MASS = 0.5, 2.0
# Gains with damping ratios of 0.2, 1 and 3 at 10 rad/s.
_SOFT = {"under": (50.0, 2.0), "critical": (50.0, 10.0), "over": (50.0, 30.0)}


def _response(trial: Trial, kind: Callable[..., ActuatorConfig]) -> Mapping[str, float]:
    """Steps of under-, critically and overdamped drives, and of one on a prismatic joint."""
    robots: list[RobotSpec] = []
    truths: list[tuple[float, float, float]] = []
    for name, (stiffness, damping) in _SOFT.items():
        drive = kind(joints=(".*",), stiffness=stiffness, damping=damping)
        robots.append(named(name, rotor(inertia=_INERTIA, actuators=(drive,))))
        truths.append((stiffness, damping, _INERTIA))
    drive = kind(joints=(".*",), stiffness=200.0, damping=20.0)
    robots.append(slider(mass=_MASS, actuators=(drive,)))
    truths.append((200.0, 20.0, _MASS))
    world = trial.world(scene(*robots, gravity=WEIGHTLESS, terrain=()))
    for robot in world.robots.values():
        robot.set_position_targets(torch.ones(1, 1, device=world.device))
    times, positions = [], []
    for time in trial.advance(world, 1.5, every=0.02):
        times.append(time)
        positions.append([float(robot.joint_positions[0, 0]) for robot in world.robots.values()])
    measured = np.array(positions)
    truth = np.stack([linear_response(*gains, times) for gains in truths], -1)
    trial.trace("underdamped step", "rad", times, measured[:, 0].tolist(), truth[:, 0].tolist())
    # The underdamped drive is a metric of its own, since its phase error grows with each swing.
    off = np.abs(measured - truth)
    return {"under": float(off[:, 0].max()), "damped": float(off[:, 1:].max()), "final": float(off[-1].max())}


def _implicit(trial: Trial) -> Mapping[str, float]:
    return _response(trial, ImplicitPd)


def _explicit(trial: Trial) -> Mapping[str, float]:
    return _response(trial, IdealPd)


# Stiffness, damping and inertia of drives: the fast modes decay 40 to 1,000 times within a time step of 5 ms.
_STIFF = {"arm": (4000.0, 400.0, 0.05), "finger": (1000.0, 20.0, 1e-4), "rigid": (1e6, 1e4, 0.5)}


def _stiff(trial: Trial) -> Mapping[str, float]:
    """Steps of drives whose fast mode no time step resolves: the slow one, ``stiffness / damping``, shows."""
    robots = [
        named(name, rotor(inertia=inertia, actuators=(ImplicitPd(joints=(".*",), stiffness=k, damping=d),)))
        for name, (k, d, inertia) in _STIFF.items()
    ]
    world = trial.world(scene(*robots, gravity=WEIGHTLESS, terrain=()))
    for robot in world.robots.values():
        robot.set_position_targets(torch.ones(1, 1, device=world.device))
    times, positions = [], []
    for time in trial.advance(world, 1.0, every=0.02):
        times.append(time)
        positions.append([float(robot.joint_positions[0, 0]) for robot in world.robots.values()])
    measured = np.array(positions)
    truth = np.stack([linear_response(*gains, times) for gains in _STIFF.values()], -1)
    trial.trace("step of an arm's stiff drive", "rad", times, measured[:, 0].tolist(), truth[:, 0].tolist())
    return {
        "response": float(np.abs(measured - truth).max()),
        "overshoot": max(0.0, float(measured.max() - 1)),
        "final": float(np.abs(measured[-1] - truth[-1]).max()),
    }


# Natural frequencies times the time step.
_SHARES = (0.3, 1.0, 2.5, 5.0, 10.0)
# Damping ratios.
_RATIOS = (0.1, 0.3, 1.0, 2.0)


def _frequencies(trial: Trial) -> Mapping[str, float]:
    """Steps of drives whose natural frequency is from well to not at all resolved by the time step."""
    robots: list[RobotSpec] = []
    truths: list[tuple[float, float, float]] = []
    for share in _SHARES:
        for ratio in _RATIOS:
            # Natural frequencies are chosen by the time step, so that each run of a sweep tests the same share of it.
            frequency = share / trial.time_step
            gains = (_INERTIA * frequency**2, 2 * ratio * _INERTIA * frequency)
            drive = ImplicitPd(joints=(".*",), stiffness=gains[0], damping=gains[1])
            robots.append(named(f"drive{len(robots)}", rotor(inertia=_INERTIA, actuators=(drive,))))
            truths.append((*gains, _INERTIA))
    world = trial.world(scene(*robots, gravity=WEIGHTLESS, terrain=()))
    for robot in world.robots.values():
        robot.set_position_targets(torch.ones(1, 1, device=world.device))
    times, rows = [], []
    for time in trial.advance(world, 300 * trial.time_step):
        times.append(time)
        rows.append(torch.cat([robot.joint_positions[0] for robot in world.robots.values()]).tolist())
    measured = np.array(rows)
    truth = np.stack([linear_response(*gains, times) for gains in truths], -1)
    # Only drives that the time step resolves can follow the linear response; the others must be bounded.
    slow = len(_RATIOS)
    trial.trace("lightly damped drive at 0.3 a step", "rad", times, measured[:, 0].tolist(), truth[:, 0].tolist())
    trial.trace("lightly damped drive at 2.5 a step", "rad", times, measured[:, 8].tolist(), truth[:, 8].tolist())
    # A lightly damped step overshoots by itself: only what goes beyond that is an error.
    peaks = np.maximum(
        1.0, 1.0 + np.exp(-math.pi * np.array(_RATIOS) / np.sqrt(np.clip(1 - np.square(_RATIOS), 1e-9, 1)))
    )
    beyond = np.maximum(measured.max(0) - np.tile(peaks, len(_SHARES)), -measured.min(0))
    return {
        "response": float(np.abs(measured - truth)[:, :slow].max()),
        "beyond": float(max(0.0, beyond.max())),
        "final": float(np.abs(measured[-1] - 1).max()),
    }


def _tracking(trial: Trial) -> Mapping[str, float]:
    """Speeds under velocity targets: a speed drive against a load, and a servo that follows a ramp."""
    robots = (
        named("speed", rotor(inertia=_INERTIA, actuators=(ImplicitPd(joints=(".*",), damping=20.0),))),
        named("ramp", rotor(inertia=_INERTIA, actuators=(ImplicitPd(joints=(".*",), stiffness=200.0, damping=20.0),))),
    )
    world = trial.world(scene(*robots, gravity=WEIGHTLESS, terrain=()))
    speed, ramp = world.robots["speed"], world.robots["ramp"]
    speed.set_velocity_targets(torch.full((1, 1), 1.5, device=world.device))
    speed.set_effort_targets(torch.full((1, 1), -4.0, device=world.device))
    ramp.set_velocity_targets(torch.full((1, 1), 0.8, device=world.device))
    lag = 0.0
    for time in trial.advance(world, 2.0):
        # Earlier the servo still catches up.
        if time > 1.5:
            lag = max(lag, abs(float(ramp.joint_positions[0, 0]) - 0.8 * time))
        # Targets hold over a step; one at its middle makes no lag on average.
        middle = 0.8 * (time + 0.5 * trial.time_step)  # of what is held over the step to come
        ramp.set_position_targets(torch.full((1, 1), middle, device=world.device))
    final = float(speed.joint_velocities[0, 0])
    return {"speed": abs(final - (1.5 - 4.0 / 20.0)) / 1.5, "ramp": lag}


_LINEAR = "Ogata, Modern Control Engineering, 5th ed., section 5.3"


@dataclass(frozen=True)
class _Case:
    """A rotor with a drive."""

    stiffness: float
    damping: float
    limit: float | None = None
    armature: float = 0.0
    drag: float = 0.0
    """Damping of the joint itself."""
    inertia: float = 0.1

    def robot(self, name: str) -> RobotSpec:
        drive = ImplicitPd(
            joints=(".*",), stiffness=self.stiffness, damping=self.damping, effort_limit=self.limit
        )  # fmt: skip
        turning = rotor(inertia=self.inertia, armature=self.armature, damping=self.drag, actuators=(drive,))
        return named(name, turning)


# Drives of 0.1 to 6 times the inertia over the step, ``h d / I`` at 5 ms.
_CASES = {
    "soft": _Case(40.0, 2.0),
    "stiff": _Case(400.0, 80.0),
    "velocity": _Case(0.0, 100.0),
    "limited": _Case(400.0, 20.0, limit=20.0),
    "geared": _Case(400.0, 80.0, armature=0.05),
    "dragged": _Case(400.0, 20.0, drag=20.0),
}
# Velocity at the start, rad/s; targets of position, rad, and of velocity, rad/s.
_START, _TARGET, _SPEED = 0.5, 0.5, 2.0


def _set_off(world: World) -> None:
    """Start all rotors at a speed, towards a target."""
    for name, case in _CASES.items():
        robot = world.robots[name]
        robot.set_joint_state(velocities=torch.full((1, 1), _START, device=world.device))
        if case.stiffness:
            robot.set_position_targets(torch.full((1, 1), _TARGET, device=world.device))
        else:
            robot.set_velocity_targets(torch.full((1, 1), _SPEED, device=world.device))


def _states(world: World) -> torch.Tensor:
    """(2, robots) positions and velocities of each robot's only joint."""
    robots = [world.robots[name] for name in _CASES]
    values = [(robot.joint_positions[0, 0], robot.joint_velocities[0, 0]) for robot in robots]
    return torch.tensor(values, dtype=torch.float64).T


_STEPS = 20


def _applied(trial: Trial) -> Mapping[str, float]:
    """The drive's effort is the change of the joint's momentum, plus what the joint's own damping took."""
    world = trial.world(scene(*(case.robot(name) for name, case in _CASES.items()), gravity=WEIGHTLESS, terrain=()))
    _set_off(world)
    inertia = torch.tensor([case.inertia + case.armature for case in _CASES.values()], dtype=torch.float64)
    drag = torch.tensor([case.drag for case in _CASES.values()], dtype=torch.float64)
    before, truths, told, over = _states(world), [], [], 0.0
    for _ in range(_STEPS):
        trial.step(world)
        after = _states(world)
        # Change of momentum over the step, by velocities before and after, needs no acceleration from the engine.
        way, change = (after - before) / trial.time_step
        truths.append(inertia * change + drag * way)
        told.append([float(world.robots[name].joint_efforts[0, 0]) for name in _CASES])
        before = after
    truth, measured = torch.stack(truths), torch.tensor(told, dtype=torch.float64)
    times = [trial.time_step * (number + 1) for number in range(_STEPS)]
    trial.trace("effort of a stiff drive", "N m", times, measured[:, 1].tolist(), truth[:, 1].tolist())
    error = (measured - truth).abs().amax(0) / truth.abs().amax(0)
    # Reported efforts may never exceed the limit, whatever momentum says.
    limit = _CASES["limited"].limit
    assert limit is not None
    over = float(measured[:, list(_CASES).index("limited")].abs().max()) / limit - 1.0
    errors = dict(zip(_CASES, error.tolist(), strict=True))
    return {**errors, "beyond_the_limit": max(0.0, over), "chain": _chain(trial)}


_LINKS = 3


def _chain(trial: Trial) -> float:
    """Largest error of the efforts on a chain of links that stiff drives raise, relative to the largest effort."""
    drive = ImplicitPd(joints=(".*",), stiffness=400.0, damping=60.0)
    world = trial.world(scene(pendulum(links=_LINKS, actuators=(drive,)), terrain=()))
    robot, truth = world.robots["pendulum"], PlanarChain(_LINKS, 0.5)
    # Different targets, so that the links' accelerations couple.
    robot.set_position_targets(torch.tensor([[-0.5, -0.3, 0.4]], device=world.device))
    state, worst, largest = np.zeros(2 * _LINKS), 0.0, 0.0
    for _ in range(_STEPS):
        trial.step(world)
        after = np.concatenate((robot.joint_positions[0].tolist(), robot.joint_velocities[0].tolist()))
        rate = (after - state) / trial.time_step
        # Inverse dynamics at the middle of the step, which is second order in the time step.
        efforts = truth.efforts(0.5 * (state + after), rate[_LINKS:])
        worst = max(worst, float(np.abs(np.array(robot.joint_efforts[0].tolist()) - efforts).max()))
        largest, state = max(largest, float(np.abs(efforts).max())), after
    return worst / largest


def _transmitted(trial: Trial) -> Mapping[str, float]:
    """The torque about a joint's axis is the change of momentum of the link that turns, without the motor's inertia."""
    robots = [case.robot(name) for name, case in _CASES.items()]
    sensors = tuple(ForceTorqueSpec(name=name, entity=name, link="rotor") for name in _CASES)
    world = trial.world(scene(*robots, sensors=sensors, gravity=WEIGHTLESS, terrain=()))
    _set_off(world)
    inertia = torch.tensor([case.inertia for case in _CASES.values()], dtype=torch.float64)
    before = _states(world)
    truths: list[torch.Tensor] = []
    told: list[list[float]] = []
    for _ in range(_STEPS):
        trial.step(world)
        after = _states(world)
        truths.append(inertia * (after - before)[1] / trial.time_step)
        meters = [world.sensors[name] for name in _CASES]
        told.append([float(meter.torque[0, 2]) for meter in meters if isinstance(meter, ForceTorqueSensor)])
        before = after
    truth, measured = torch.stack(truths), torch.tensor(told, dtype=torch.float64)
    times = [trial.time_step * (number + 1) for number in range(_STEPS)]
    trial.trace("torque on a geared link", "N m", times, measured[:, 4].tolist(), truth[:, 4].tolist())
    error = (measured - truth).abs().amax(0) / truth.abs().amax(0)
    return {"torque": float(error.max())}


_MOMENTUM = "impulse and momentum about a fixed axis: Landau and Lifshitz, Mechanics, 3rd ed., sections 7 and 34"


SCENARIOS = (
    Scenario(
        name="implicit_drive",
        group="Drives",
        question="Does the engine's PD drive answer a step as a linear second-order system does?",
        truth="I a = k (1 - q) - d v from rest, at damping ratios 0.2, 1, 3 (10 rad/s) and 0.5 (slider)",
        source=_LINEAR,
        judges=(Capability.IMPLICIT_DRIVES,),
        run=_implicit,
        needs=(Capability.IMPLICIT_DRIVES,),
        metrics=(
            Metric(
                name="under",
                unit="",
                tolerance=0.02,
                meaning="largest error at damping ratio 0.2, relative to the step",
                looser_because=FIRST_ORDER,
            ),
            Metric(
                name="damped",
                unit="",
                tolerance=0.01,
                meaning="largest error of the others, relative to the step",
                looser_because=FIRST_ORDER,
            ),
            Metric(
                name="final",
                unit="",
                tolerance=2.5e-3,
                meaning="largest error after 1.5 s, relative to the step",
                looser_because=FIRST_ORDER,
            ),
        ),
    ),
    Scenario(
        name="explicit_drive",
        group="Drives",
        question="Does a PD law evaluated at each physics step answer a step as the linear system does?",
        truth="I a = k (1 - q) - d v from rest, at damping ratios 0.2, 1, 3 (10 rad/s) and 0.5 (slider)",
        source=_LINEAR,
        run=_explicit,
        metrics=(
            Metric(
                name="under",
                unit="",
                tolerance=0.03,
                meaning="largest error at damping ratio 0.2, relative to the step",
            ),
            Metric(
                name="damped", unit="", tolerance=0.025, meaning="largest error of the others, relative to the step"
            ),
            Metric(name="final", unit="", tolerance=0.005, meaning="largest error after 1.5 s, relative to the step"),
        ),
    ),
    Scenario(
        name="stiff_drive",
        group="Drives",
        question="Is a drive much stiffer than the time step resolves stable, and as fast as its slow mode?",
        truth="I a = k (1 - q) - d v from rest, with d / I from 8,000 to 200,000 per second",
        source=_LINEAR,
        judges=(Capability.IMPLICIT_DRIVES,),
        run=_stiff,
        needs=(Capability.IMPLICIT_DRIVES,),
        metrics=(
            Metric(
                name="response",
                unit="",
                tolerance=0.08,
                meaning="largest error, relative to the step",
                looser_because=FIRST_ORDER,
            ),
            Metric(
                name="overshoot",
                unit="",
                tolerance=1e-6,
                meaning="beyond the target, relative to the step",
                looser_because=SINGLE,
            ),
            Metric(
                name="final",
                unit="",
                tolerance=3e-5,
                meaning="largest error after 1 s, relative to the step",
                looser_because=SINGLE,
            ),
        ),
    ),
    Scenario(
        name="drive_frequencies",
        group="Drives",
        question="Is a drive bounded and settled whatever its natural frequency and damping are to the time step?",
        truth="I a = k (1 - q) - d v from rest; frequency x step of 0.3 to 10, damping ratios of 0.1 to 2",
        source=_LINEAR,
        judges=(Capability.IMPLICIT_DRIVES,),
        run=_frequencies,
        needs=(Capability.IMPLICIT_DRIVES,),
        metrics=(
            Metric(
                name="response",
                unit="",
                tolerance=0.06,
                meaning="largest error of those at 0.3 radians a step, relative to the step",
            ),
            Metric(
                name="beyond",
                unit="",
                tolerance=1e-3,
                looser_because="the best stay within",
                meaning="largest excursion of any beyond the linear system's peak, or below the start",
            ),
            Metric(
                name="final",
                unit="",
                tolerance=3e-4,
                meaning="largest distance of any from its target after 300 steps, relative to the step",
                looser_because="the linear system itself is 1e-4 away",
            ),
        ),
    ),
    Scenario(
        name="drive_tracking",
        group="Drives",
        question="Does a drive hold a speed against a load, and follow a ramp without lag?",
        truth="v = v* + tau / d; q = v* t with both targets moving",
        source=_LINEAR,
        judges=(Capability.IMPLICIT_DRIVES,),
        run=_tracking,
        needs=(Capability.IMPLICIT_DRIVES,),
        metrics=(
            Metric(
                name="speed",
                unit="",
                tolerance=1e-5,
                meaning="error of the steady speed, relative to the target",
                looser_because=SINGLE,
            ),
            Metric(
                name="ramp",
                unit="rad",
                tolerance=2.5e-3,
                meaning="largest lag after 1.5 s",
                looser_because="integrators of first order lag or lead by half a step of the ramp",
            ),
        ),
    ),
    Scenario(
        name="applied_effort",
        group="Joints",
        question="Is the effort that a joint reports the one that its drive applied, whatever the drive's gains?",
        truth="effort = (I + armature) (v1 - v0) / h + d (q1 - q0) / h, d of the joint; of a chain, its equations",
        source=_MOMENTUM,
        run=_applied,
        needs=(Capability.IMPLICIT_DRIVES, Capability.EFFORT_LIMITS, Capability.ARMATURE, Capability.JOINT_DAMPING),
        metrics=(
            *(
                Metric(
                    name=name,
                    unit="",
                    tolerance=1e-5,
                    meaning=f"{meaning}; relative to the largest effort",
                    looser_because=SINGLE,
                )
                for name, meaning in (
                    ("soft", "largest error of a drive of 40 N m/rad and 2 N m s/rad on 0.1 kg m^2"),
                    ("stiff", "largest error of a drive of 400 N m/rad and 80 N m s/rad"),
                    ("velocity", "largest error of a drive of 100 N m s/rad alone"),
                    ("limited", "largest error of a drive that reaches its limit"),
                    ("geared", "largest error of a drive on a joint with armature"),
                    ("dragged", "largest error of a drive on a joint with damping of its own"),
                )
            ),
            Metric(
                name="beyond_the_limit",
                unit="",
                tolerance=1e-5,
                looser_because=SINGLE,
                meaning="effort above the limit, relative to it",
            ),
            Metric(
                name="chain",
                unit="",
                tolerance=5e-4,
                meaning="largest error on a chain of three links, relative to the largest effort",
                looser_because="the truth takes the chain's equations at the middle of the step",
            ),
        ),
    ),
    Scenario(
        name="transmitted_effort",
        group="Joints",
        question="Does a joint's wrench hold what its drive gave to the link, and no more?",
        truth="torque about the axis = I (v1 - v0) / h, whatever the gains, the armature and the joint's damping",
        source=_MOMENTUM,
        run=_transmitted,
        needs=(Capability.IMPLICIT_DRIVES, Capability.EFFORT_LIMITS, Capability.JOINT_WRENCHES),
        metrics=(
            Metric(
                name="torque",
                unit="",
                tolerance=1e-5,
                looser_because=SINGLE,
                meaning="largest error over all drives, relative to the largest torque on each link",
            ),
        ),
    ),
)
