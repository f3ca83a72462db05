"""Efforts that drives applied, and what joints transmit of them, against the change of momentum over a step."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import torch

from orbit_conformance.bodies import WEIGHTLESS, pendulum, rotor, scene
from orbit_conformance.reference import PlanarChain
from orbit_conformance.scenario import SINGLE, Metric, Scenario, Trial
from orbit_conformance.scenarios.joints import named
from orbit_core.interfaces import Capability, World
from orbit_core.scene import ForceTorqueSpec, ImplicitPd, RobotSpec
from orbit_core.sensors.proprioception import ForceTorqueSensor


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


_CASES = {
    "soft": _Case(40.0, 2.0),
    "stiff": _Case(400.0, 80.0),
    "velocity": _Case(0.0, 100.0),
    "limited": _Case(400.0, 20.0, limit=20.0),
    "geared": _Case(400.0, 80.0, armature=0.05),
    "dragged": _Case(400.0, 20.0, drag=20.0),
}
"""Drives of 0.1 to 6 times the inertia over the step, ``h d / I`` at 5 ms."""
_START, _TARGET, _SPEED = 0.5, 0.5, 2.0
"""Velocity at the start, rad/s; targets of position, rad, and of velocity, rad/s."""


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
        way, change = (after - before) / trial.time_step
        truths.append(inertia * change + drag * way)
        told.append([float(world.robots[name].joint_efforts[0, 0]) for name in _CASES])
        before = after
    truth, measured = torch.stack(truths), torch.tensor(told, dtype=torch.float64)
    times = [trial.time_step * (number + 1) for number in range(_STEPS)]
    trial.trace("effort of a stiff drive", "N m", times, measured[:, 1].tolist(), truth[:, 1].tolist())
    error = (measured - truth).abs().amax(0) / truth.abs().amax(0)
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
    robot.set_position_targets(torch.tensor([[-0.5, -0.3, 0.4]], device=world.device))
    state, worst, largest = np.zeros(2 * _LINKS), 0.0, 0.0
    for _ in range(_STEPS):
        trial.step(world)
        after = np.concatenate((robot.joint_positions[0].tolist(), robot.joint_velocities[0].tolist()))
        rate = (after - state) / trial.time_step
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
        name="applied_effort",
        group="Joints",
        question="Is the effort that a joint reports the one that its drive applied, whatever the drive's gains?",
        truth="effort = (I + armature) (v1 - v0) / h + d (q1 - q0) / h, d of the joint; of a chain, its equations",
        source=_MOMENTUM,
        run=_applied,
        needs=(Capability.IMPLICIT_DRIVES, Capability.EFFORT_LIMITS, Capability.ARMATURE, Capability.JOINT_DAMPING),
        metrics=(
            *(
                Metric(name=name, unit="", tolerance=1e-5, meaning=f"{meaning}; relative to the largest effort",
                       looser_because=SINGLE)
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
                name="beyond_the_limit", unit="", tolerance=1e-5, looser_because=SINGLE,
                meaning="effort above the limit, relative to it",
            ),
            Metric(
                name="chain", unit="", tolerance=5e-4,
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
                name="torque", unit="", tolerance=1e-5, looser_because=SINGLE,
                meaning="largest error over all drives, relative to the largest torque on each link",
            ),
        ),
    ),
)  # fmt: skip
