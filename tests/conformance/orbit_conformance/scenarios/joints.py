"""Joints that are pushed, dragged, limited and coupled: each about a fixed axis, so that the truth is a line or two."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace
from functools import cache

import numpy as np
import torch

from orbit_conformance.bodies import WEIGHTLESS, G, pendulum, rotor, scene, slider
from orbit_conformance.reference import FloatArray, PlanarChain, trajectory
from orbit_conformance.scenario import FIRST_ORDER, SINGLE, Metric, Scenario, Trial
from orbit_core.interfaces import Capability, World
from orbit_core.scene import IdealPd, ImplicitPd, RobotSpec

_INERTIA, _MASS = 0.5, 2.0
_MOTOR = (IdealPd(joints=(".*",)),)


def named(name: str, robot: RobotSpec, x: float = 0.0) -> RobotSpec:
    """The robot with another name, moved aside."""
    return replace(robot, name=name, pose=replace(robot.pose, position=(x, 0.0, robot.pose.position[2])))


def speeds(world: World) -> torch.Tensor:
    """Velocity (N, robots) of each robot's only joint."""
    return torch.cat([robot.joint_velocities for robot in world.robots.values()], -1).double().cpu()


def push(world: World, efforts: list[list[float]]) -> None:
    """Apply efforts (N, robots) to each robot's only joint."""
    given = torch.tensor(efforts, device=world.device)
    for column, robot in enumerate(world.robots.values()):
        robot.set_effort_targets(given[:, column : column + 1])


# Effort and inertia --------------------------------------------------------------------------------------------------


def _actuation(trial: Trial) -> Mapping[str, float]:
    robots = (named("rotor", rotor(inertia=_INERTIA, actuators=_MOTOR)), slider(mass=_MASS, actuators=_MOTOR))
    world = trial.world(scene(*robots, gravity=WEIGHTLESS, terrain=()), num_envs=3)
    efforts = [[1.0, 3.0], [-2.5, 0.4], [0.03, -40.0]]
    push(world, efforts)
    rates = torch.tensor(efforts, dtype=torch.float64) / torch.tensor([_INERTIA, _MASS], dtype=torch.float64)
    error, curve = torch.zeros(2, dtype=torch.float64), []
    for time in trial.advance(world, 1.0, every=0.1):
        if time:
            error = torch.maximum(error, (speeds(world) / (rates * time) - 1).abs().amax(0))
        curve.append((time, float(speeds(world)[0, 0]), float(rates[0, 0]) * time))
    trial.trace("velocity of the rotor", "rad/s", *zip(*curve, strict=True))
    return {"revolute": float(error[0]), "prismatic": float(error[1])}


_ARMATURE = 0.05


def _geared_chain() -> RobotSpec:
    """A double pendulum whose joints carry motors' inertia."""
    robot = pendulum()
    joints = tuple(replace(joint, armature=_ARMATURE) for joint in robot.articulation.joints)
    return replace(robot, articulation=replace(robot.articulation, joints=joints))


@cache
def _chain_angles(times: tuple[float, ...]) -> FloatArray:
    return trajectory(PlanarChain(2, 0.5, armature=_ARMATURE).derivative, np.zeros(4), times)[:, :2]


def _reflected_inertia(trial: Trial) -> Mapping[str, float]:
    robots = (
        named("rotor", rotor(inertia=_INERTIA, armature=0.25, actuators=_MOTOR)),
        named("light", rotor(inertia=0.001, armature=0.1, actuators=_MOTOR)),
        named("slider", slider(mass=_MASS, armature=3.0, actuators=_MOTOR)),
    )
    world = trial.world(scene(*robots, gravity=WEIGHTLESS, terrain=()))
    push(world, [[1.0, 0.2, 4.0]])
    rates = torch.tensor([1.0 / 0.75, 0.2 / 0.101, 4.0 / 5.0], dtype=torch.float64)
    error = 0.0
    for time in trial.advance(world, 1.0, every=0.1):
        if time:
            error = max(error, float((speeds(world) / (rates * time) - 1).abs().max()))
    chain = trial.world(scene(_geared_chain(), terrain=()))
    times, angles = [], []
    for time in trial.advance(chain, 0.5, every=0.02):
        times.append(time)
        angles.append(chain.robots["pendulum"].joint_positions[0].tolist())
    truth = _chain_angles(tuple(times))
    trial.trace("angle of the upper hinge", "rad", times, [a for a, _ in angles], truth[:, 0].tolist())
    return {"single": error, "chain": float(np.abs(np.array(angles) - truth).max())}


# What drags ----------------------------------------------------------------------------------------------------------


def _damping(trial: Trial) -> Mapping[str, float]:
    """Decay rates of 2 and 10 per second, and one far beyond what explicit integration bears."""
    rates = {"light": 2.0, "heavy": 10.0, "stiff": 2000.0}
    robots = [named(name, rotor(inertia=_INERTIA, damping=_INERTIA * rate)) for name, rate in rates.items()]
    robots.append(named("slider", slider(mass=_MASS, damping=2.0 * _MASS)))
    world = trial.world(scene(*robots, gravity=WEIGHTLESS, terrain=()))
    for robot in world.robots.values():
        robot.set_joint_state(velocities=torch.full((1, 1), 3.0, device=world.device))
    rate = torch.tensor([*rates.values(), 2.0], dtype=torch.float64)
    curve, error, stiff = [], 0.0, 0.0
    for time in trial.advance(world, 1.0, every=0.05):
        off = (speeds(world)[0] / 3.0 - torch.exp(-rate * time)).abs()
        error = max(error, float(off[[0, 1, 3]].max()))
        stiff = max(stiff, float(off[2]))
        curve.append((time, float(speeds(world)[0, 1]), 3.0 * math.exp(-10.0 * time)))
    trial.trace("velocity under heavy damping", "rad/s", *zip(*curve, strict=True))
    return {"decay": error, "stiff": stiff}


_FRICTION = 0.5


def _friction(trial: Trial) -> Mapping[str, float]:
    """One joint slides to a stop, one is pushed with less than friction, one with more, one is driven on at a speed."""
    drive = (ImplicitPd(joints=(".*",), damping=5.0),)
    robots = (
        named("sliding", rotor(inertia=_INERTIA, friction=_FRICTION, actuators=_MOTOR)),
        named("stuck", rotor(inertia=_INERTIA, friction=_FRICTION, actuators=_MOTOR)),
        named("pushed", rotor(inertia=_INERTIA, friction=_FRICTION, actuators=_MOTOR)),
        named("driven", rotor(inertia=_INERTIA, friction=_FRICTION, actuators=drive)),
    )
    world = trial.world(scene(*robots, gravity=WEIGHTLESS, terrain=()))
    start = 2.0
    world.robots["sliding"].set_joint_state(velocities=torch.full((1, 1), start, device=world.device))
    # One below the friction, which must hold, and one above, which must move.
    push(world, [[0.0, 0.8 * _FRICTION, 1.5 * _FRICTION, 0.0]])
    world.robots["driven"].set_velocity_targets(torch.full((1, 1), start, device=world.device))
    slowing = _FRICTION / _INERTIA
    curve, sliding, gaining = [], 0.0, 0.0
    for time in trial.advance(world, 3.0, every=0.1):
        speed = speeds(world)[0]
        truth = max(0.0, start - slowing * time)
        sliding = max(sliding, abs(float(speed[0]) - truth) / start)
        gaining = max(gaining, abs(float(speed[2]) - 0.5 * slowing * time) / (0.5 * slowing * 3.0))
        curve.append((time, float(speed[0]), truth))
    trial.trace("velocity of the sliding joint", "rad/s", *zip(*curve, strict=True))
    final, stuck = speeds(world)[0], world.robots["stuck"].joint_positions
    return {
        "sliding": sliding,
        "creep": abs(float(stuck[0, 0])) / 3.0,
        "pushed": gaining,
        "driven": abs(float(final[3]) - (start - _FRICTION / 5.0)) / start,
    }


# What stops ----------------------------------------------------------------------------------------------------------


def _effort_limits(trial: Trial) -> Mapping[str, float]:
    """Efforts far beyond the limit, from commands, from the engine's drive and from the core's."""
    implicit = ImplicitPd(joints=(".*",), stiffness=1000.0, damping=100.0, effort_limit=2.0)
    ideal = IdealPd(joints=(".*",), stiffness=1000.0, damping=100.0, effort_limit=2.0)
    robots = (
        named("motor", rotor(inertia=_INERTIA, effort_limit=2.0, actuators=_MOTOR)),
        named("implicit", rotor(inertia=_INERTIA, actuators=(implicit,))),
        named("ideal", rotor(inertia=_INERTIA, actuators=(ideal,))),
        named("slider", slider(mass=_MASS, effort_limit=2.0, actuators=_MOTOR)),
    )
    world = trial.world(scene(*robots, gravity=WEIGHTLESS, terrain=()))
    push(world, [[10.0, 10.0, 10.0, -10.0]])
    for name in ("implicit", "ideal"):
        world.robots[name].set_position_targets(torch.full((1, 1), 50.0, device=world.device))
    # All are limited to 2 N m (2 N), whatever is commanded.
    rates = torch.tensor([2.0 / _INERTIA] * 3 + [-2.0 / _MASS], dtype=torch.float64)
    error = effort = 0.0
    for time in trial.advance(world, 0.5, every=0.05):
        if time:
            error = max(error, float((speeds(world)[0] / (rates * time) - 1).abs().max()))
            told = torch.cat([robot.joint_efforts[0] for robot in world.robots.values()]).abs().cpu()
            effort = max(effort, float((told / 2.0 - 1).abs().max()))
    return {"acceleration": error, "effort": effort, **_strong_drives(trial)}


# On 0.1 kg m^2: its damping over a step of 5 ms is five times the inertia.
_STRONG = ImplicitPd(joints=(".*",), damping=100.0, effort_limit=10.0)
# Too weak to hold a level link of 1 kg with its centre 0.25 m from the hinge.
_HOLDING = ImplicitPd(joints=(".*",), damping=100.0, effort_limit=0.5)


def _strong_drives(trial: Trial) -> Mapping[str, float]:
    """A drive leaves its limit and reaches its target; one that a load strikes at rest gives its limit and no more."""
    world = trial.world(scene(named("settling", rotor(inertia=0.1, actuators=(_STRONG,))), gravity=WEIGHTLESS))
    robot = world.robots["settling"]
    # A speed that the drive passes while it is at its limit, so that it has to leave the limit again.
    wanted = 2.25
    robot.set_velocity_targets(torch.full((1, 1), wanted, device=world.device))
    trial.step(world, trial.steps(0.5))
    off = 0.0
    for _ in trial.advance(world, 0.05):
        off = max(off, abs(float(robot.joint_velocities[0, 0]) / wanted - 1.0))
    world = trial.world(scene(pendulum(links=1, actuators=(_HOLDING,)), terrain=()))
    # Short: the arm is still level, and gravity's torque constant.
    falling = 0.05
    trial.step(world, trial.steps(falling))
    limit = _HOLDING.effort_limit
    assert limit is not None
    truth = (G * 0.25 - limit) / (0.01 + 0.25**2) * falling
    return {"settling": off, "struck": abs(float(world.robots["pendulum"].joint_velocities[0, 0]) / truth - 1.0)}


_FASTEST = 1.5


def _velocity_limits(trial: Trial) -> Mapping[str, float]:
    """A motor, and a drive towards a target far away; neither may pass the limit, nor keep from it."""
    drive = (ImplicitPd(joints=(".*",), stiffness=100.0, damping=1.0),)
    robots = (
        named("motor", rotor(inertia=_INERTIA, velocity_limit=_FASTEST, actuators=_MOTOR)),
        named("driven", rotor(inertia=_INERTIA, velocity_limit=_FASTEST, actuators=drive)),
        named("slider", slider(mass=_MASS, velocity_limit=_FASTEST, actuators=_MOTOR)),
    )
    world = trial.world(scene(*robots, gravity=WEIGHTLESS, terrain=()))
    push(world, [[2.0, 0.0, 8.0]])
    world.robots["driven"].set_position_targets(torch.full((1, 1), 10.0, device=world.device))
    curve, excess = [], 0.0
    for time in trial.advance(world, 1.5, every=0.05):
        speed = speeds(world)[0]
        excess = max(excess, float(speed.abs().max()) / _FASTEST - 1)
        curve.append((time, float(speed[0]), min(_FASTEST, 2.0 / _INERTIA * time)))
    trial.trace("velocity of the motor's joint", "rad/s", *zip(*curve, strict=True))
    return {"excess": excess, "reached": float((speeds(world)[0] / _FASTEST - 1).abs().max())}


_HAND = "2nd law about a fixed axis: Landau and Lifshitz, Mechanics, 3rd ed., sections 32 and 34"

SCENARIOS = (
    Scenario(
        name="joint_actuation",
        group="Joints",
        question="Does an effort on a joint accelerate it as Newton says?",
        truth="omega = tau t / I, v = F t / m, in environments with efforts of their own",
        source=_HAND,
        run=_actuation,
        metrics=(
            Metric(
                name="revolute",
                unit="",
                tolerance=1e-5,
                meaning="largest error of the angular velocity, relative",
                looser_because=SINGLE,
            ),
            Metric(
                name="prismatic",
                unit="",
                tolerance=1e-5,
                meaning="largest error of the velocity, relative",
                looser_because=SINGLE,
            ),
        ),
    ),
    Scenario(
        name="reflected_inertia",
        group="Joints",
        question="Does the inertia of a geared motor act on its joint, and on it alone?",
        truth="omega = tau t / (I + armature); in a chain, armature on the diagonal of the joint-space inertia",
        source="Featherstone, Rigid Body Dynamics Algorithms, 2008, section 9.6",
        judges=(Capability.ARMATURE,),
        run=_reflected_inertia,
        metrics=(
            Metric(
                name="single",
                unit="",
                tolerance=1e-5,
                meaning="largest error of the velocity, relative",
                looser_because=SINGLE,
            ),
            Metric(
                name="chain", unit="rad", tolerance=0.02, meaning="largest error of a double pendulum's angle in 0.5 s"
            ),
        ),
    ),
    Scenario(
        name="joint_damping",
        group="Joints",
        question="Does a damped joint lose its speed exponentially, however strong the damper?",
        truth="v = v0 exp(-d t / I)",
        source="Landau and Lifshitz, Mechanics, 3rd ed., section 25",
        judges=(Capability.JOINT_DAMPING,),
        run=_damping,
        metrics=(
            Metric(
                name="decay",
                unit="",
                tolerance=0.01,
                meaning="largest error at 2 and 10 /s, relative to v0",
                looser_because=FIRST_ORDER,
            ),
            Metric(
                name="stiff",
                unit="",
                tolerance=1e-6,
                meaning="largest error at 2000 /s, relative to v0",
                looser_because=SINGLE,
            ),
        ),
    ),
    Scenario(
        name="joint_friction",
        group="Joints",
        question="Does Coulomb friction in a joint slow it evenly, hold it, and let a stronger push through?",
        truth="v = v0 - f t / I until rest; rest below f; v = (tau - f) t / I above; v = v* - f / d under a drive",
        source="Armstrong-Helouvry, Dupont and Canudas de Wit, Automatica 30(7), 1994, section 2.1",
        judges=(Capability.JOINT_FRICTION,),
        run=_friction,
        needs=(Capability.JOINT_FRICTION,),
        metrics=(
            Metric(
                name="sliding",
                unit="",
                tolerance=1e-5,
                meaning="largest error of the velocity, relative to v0",
                looser_because=SINGLE,
            ),
            Metric(
                name="creep",
                unit="rad/s",
                tolerance=1e-5,
                meaning="mean speed over 3 s, pushed with 0.8 f",
                looser_because="a hundred-thousandth of a radian in a second is rest for every purpose",
            ),
            Metric(
                name="pushed",
                unit="",
                tolerance=2e-5,
                meaning="largest error of the velocity with 1.5 f, relative",
                looser_because=SINGLE,
            ),
            Metric(
                name="driven",
                unit="",
                tolerance=1e-5,
                meaning="error of the steady velocity, relative to the target",
                looser_because=SINGLE,
            ),
        ),
    ),
    Scenario(
        name="effort_limits",
        group="Joints",
        question="Does a joint's effort limit bound the sum of command and drive?",
        truth="omega = limit t / I, whatever is asked",
        source=_HAND,
        judges=(Capability.EFFORT_LIMITS,),
        run=_effort_limits,
        needs=(Capability.EFFORT_LIMITS,),
        metrics=(
            Metric(
                name="acceleration",
                unit="",
                tolerance=1e-5,
                meaning="largest error of the velocity, relative",
                looser_because=SINGLE,
            ),
            Metric(
                name="effort",
                unit="",
                tolerance=1e-5,
                meaning="largest error of the effort told, relative",
                looser_because=SINGLE,
            ),
            Metric(
                name="settling",
                unit="",
                tolerance=1e-5,
                meaning="largest error of the speed half a second after a strong velocity drive set out, relative",
                looser_because=SINGLE,
            ),
            Metric(
                name="struck",
                unit="",
                tolerance=4e-4,
                meaning="error of the speed 0.05 s after a load met a drive too weak for it, relative",
            ),
        ),
    ),
    Scenario(
        name="velocity_limits",
        group="Joints",
        question="Does a joint stop gaining speed at its velocity limit?",
        truth="omega = min(limit, tau t / I)",
        source=_HAND,
        judges=(Capability.VELOCITY_LIMITS,),
        run=_velocity_limits,
        needs=(Capability.VELOCITY_LIMITS,),
        metrics=(
            Metric(name="excess", unit="", tolerance=0.02, meaning="largest speed beyond the limit, relative"),
            Metric(name="reached", unit="", tolerance=0.02, meaning="distance from the limit at the end, relative"),
        ),
    ),
)
