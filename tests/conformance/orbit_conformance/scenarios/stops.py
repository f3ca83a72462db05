"""Joint limits that are run into, and pushed against."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import torch

from orbit_conformance.bodies import WEIGHTLESS, rotor, scene
from orbit_conformance.scenario import SINGLE, Metric, Scenario, Trial
from orbit_conformance.scenarios.joints import named
from orbit_core.interfaces import Capability
from orbit_core.scene import ActuatorConfig, ImplicitPd, JointType, RobotSpec

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
                name="passed", unit="rad", tolerance=1e-5, looser_because=SINGLE,
                meaning="largest angle beyond the limit, at 20 rad/s, over impacts early and late in a step",
            ),
            Metric(
                name="rebound", unit="", tolerance=1e-5, looser_because=SINGLE,
                meaning="largest speed away from the limit, relative to that of the impact",
            ),
            Metric(
                name="held", unit="rad", tolerance=1e-3, meaning="angle beyond the limit under 100 N m at rest",
                looser_because="a thousandth of a radian is less than the play of hinges",
            ),
        ),
    ),
)  # fmt: skip
