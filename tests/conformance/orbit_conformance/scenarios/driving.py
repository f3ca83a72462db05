"""Wheels that drive a base."""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np
import torch

from orbit_conformance.bodies import SMOOTH, scene
from orbit_conformance.scenario import Metric, Scenario, Trial
from orbit_core.interfaces import Capability
from orbit_core.scene import (
    Articulation,
    ImplicitPd,
    Joint,
    JointType,
    Link,
    PhysicsMaterial,
    Pose,
    RobotSpec,
    Shape,
    Sphere,
)

_RADIUS, _TRACK, _CASTER = 0.1, 0.4, 0.05
# Of a wheel about its axle, kg m^2, and of its drive, N m s/rad: 50 times the inertia over a step of 5 ms.
_INERTIA, _DAMPING = 2e-3, 20.0
_SPEED = 0.5


def _base() -> RobotSpec:
    """10 kg on two driven wheels and a smooth caster behind them."""
    caster = Shape(Sphere(_CASTER), Pose((-0.2, 0.0, _CASTER - _RADIUS)), SMOOTH)
    trunk = Link("trunk", 10.0, (-0.03, 0.0, 0.0), np.diag((0.1, 0.2, 0.2)), collisions=(caster,))
    tyre = Shape(Sphere(_RADIUS), material=PhysicsMaterial(1.0, 1.0))
    moments = np.diag((0.5 * _INERTIA, _INERTIA, 0.5 * _INERTIA))
    wheels = {"left": 0.5 * _TRACK, "right": -0.5 * _TRACK}
    links = tuple(Link(name, 0.4, (0.0, 0.0, 0.0), moments, collisions=(tyre,)) for name in wheels)
    joints = tuple(
        Joint(f"{name}_axle", JointType.CONTINUOUS, "trunk", name, Pose((0.0, y, 0.0)), axis=(0.0, 1.0, 0.0))
        for name, y in wheels.items()
    )
    drive = ImplicitPd(joints=(".*",), damping=_DAMPING)
    articulation = Articulation("base", (trunk, *links), joints)
    return RobotSpec(name="base", articulation=articulation, pose=Pose((0.0, 0.0, _RADIUS)), actuators=(drive,))


def _driven(trial: Trial) -> Mapping[str, float]:
    """Command half a metre per second from rest: friction limits what a strong drive may do."""
    world = trial.world(scene(_base()))
    base = world.robots["base"]
    trial.step(world, trial.steps(0.2))
    base.set_velocity_targets(torch.full((1, 2), _SPEED / _RADIUS, device=world.device))
    times: list[float] = []
    speeds: list[float] = []
    pitch = 0.0
    for time in trial.advance(world, 1.2):
        w, _, y, _ = base.root_pose[0, 3:].tolist()
        pitch = max(pitch, abs(2.0 * math.atan2(y, w)))
        times.append(time)
        speeds.append(float(base.root_velocity[0, 0]))
    trial.trace("speed of the base", "m/s", times, speeds, [_SPEED] * len(times))
    later = np.array(speeds[len(speeds) // 2 :])
    return {
        "speed": abs(float(later.mean()) / _SPEED - 1.0),
        "overshoot": max(0.0, max(speeds) / _SPEED - 1.0),
        "pitch": pitch,
    }


SCENARIOS = (
    Scenario(
        name="driven_wheels",
        group="Friction",
        question="Do light wheels under strong velocity drives drive their base, and not throw it?",
        truth="v = omega r once friction has brought the base to speed, and a trunk that stays level",
        source="Siegwart, Nourbakhsh and Scaramuzza, Introduction to Autonomous Mobile Robots, 2nd ed., section 3.2",
        run=_driven,
        needs=(Capability.FLOATING_BASE, Capability.IMPLICIT_DRIVES, Capability.FRICTION),
        metrics=(
            Metric(
                name="speed", unit="", tolerance=0.02, meaning="error of the mean speed in the second half, relative"
            ),
            Metric(
                name="overshoot",
                unit="",
                tolerance=0.01,
                meaning="speed beyond the commanded one, relative to it",
                looser_because="a hundredth of its speed is less than any base's odometry tells apart",
            ),
            Metric(
                name="pitch",
                unit="rad",
                tolerance=5e-3,
                meaning="largest tilt of the trunk",
                looser_because="a third of a degree is less than the unevenness of floors",
            ),
        ),
    ),
)
