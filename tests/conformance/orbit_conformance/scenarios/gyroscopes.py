"""Bodies that spin fast: a gyroscope under gravity, and free ones."""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np
import torch

from orbit_conformance.bodies import WEIGHTLESS, G, scene
from orbit_conformance.scenario import FIRST_ORDER, SINGLE, Metric, Scenario, Trial
from orbit_conformance.scenarios.free_motion import momenta
from orbit_core.dynamics.transforms import quat_rotate
from orbit_core.scene import (
    Articulation,
    Box,
    Joint,
    JointType,
    Link,
    ObjectSpec,
    Pose,
    RobotSpec,
    Shape,
    single_link,
)

SPIN = 300.0
"""Spin in rad/s: 17 degrees in a millisecond."""

# On gimbals ----------------------------------------------------------------------------------------------------------

_MASS, _RADIUS, _LEVER = 1.0, 0.1, 0.1
_AXIAL = 0.5 * _MASS * _RADIUS**2
_PRECESSION = _MASS * G * _LEVER / (_AXIAL * SPIN)


def _gyroscope() -> RobotSpec:
    """A disc on a level axle along x that turns on gimbals about z and y, 0.1 m aside of them."""
    ring = np.eye(3) * 1e-4
    links = (
        Link("base", 1.0, (0.0, 0.0, 0.0), np.eye(3)),
        Link("outer", 0.01, (0.0, 0.0, 0.0), ring),
        Link("inner", 0.01, (0.0, 0.0, 0.0), ring),
        Link("disc", _MASS, (_LEVER, 0.0, 0.0), np.diag([_AXIAL, _AXIAL / 2, _AXIAL / 2])),
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
            beyond = math.acos(max(-1.0, min(1.0, along))) - _nutation(_MOMENTS[name])
            error["axis"] = max(error["axis"], beyond)
            if name == "asymmetric":
                curve.append((time, float(now.energy), float(then.energy)))
    trial.trace("energy of the asymmetric body", "J", *zip(*curve, strict=True))
    return error


SCENARIOS = (
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
