"""Couplings beyond gears and pins: mimic joints of a curved law, and loops that are welded."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import torch

from orbit_conformance.bodies import WEIGHTLESS, geared, scene
from orbit_conformance.scenario import Metric, Scenario, Trial
from orbit_conformance.scenarios.linkages import PARALLELOGRAM, four_bar
from orbit_core.dynamics.transforms import quat_distance, quat_multiply
from orbit_core.interfaces import Capability
from orbit_core.scene import IdealPd, LoopType, Mimic, Pose, RobotSpec

_LAW = Mimic("leader", 0.5, 0.1, (0.4, -0.3, 0.2))
_INERTIA = 0.1


def _curved_mimic(trial: Trial) -> Mapping[str, float]:
    """A leader is let go at speed, without forces: the energy of both rotors is constant."""
    robot = geared(1.0, 0.1, (IdealPd(joints=(".*",)),))
    leader, follower = robot.articulation.joints
    articulation = replace(robot.articulation, joints=(leader, replace(follower, mimic=_LAW)))
    world = trial.world(scene(replace(robot, articulation=articulation), gravity=WEIGHTLESS, terrain=()))
    thing, speed = world.robots["geared"], 1.0
    at = torch.tensor([[-0.8, speed]], device=world.device)
    thing.set_joint_state(at[:, :1], at[:, 1:], joints=[0])
    start = _INERTIA * speed**2 * (1 + _LAW.slope(-0.8) ** 2) / 2
    coupling = energy = 0.0
    curve = []
    for time in trial.advance(world, 1.5):
        q, other = thing.joint_positions[0].tolist()
        v = float(thing.joint_velocities[0, 0])
        coupling = max(coupling, abs(other - _LAW.position(q)))
        energy = max(energy, abs(_INERTIA * v**2 * (1 + _LAW.slope(q) ** 2) / 2 / start - 1))
        curve.append((time, other, _LAW.position(q)))
    trial.trace("angle of the follower", "rad", *zip(*curve, strict=True))
    return {"coupling": coupling, "energy": energy}


# Angle in rad of the crank from level.
_START = -1.1


def _welded() -> RobotSpec:
    """A parallelogram whose last hinge is a weld: three hinges and a weld leave it no way to move."""
    robot = four_bar("welded", PARALLELOGRAM, (_START, -_START, _START))
    (pin,) = robot.articulation.loops
    turned = Pose.from_axis_angle((0.0, -1.0, 0.0), _START)  # the coupler is level, the rocker parallel to the crank
    weld = replace(pin, type=LoopType.WELD, orientation=turned.orientation)
    return replace(robot, articulation=replace(robot.articulation, loops=(weld,)))


def _weld(trial: Trial) -> Mapping[str, float]:
    """The parallelogram under its weight; with a hinge for the weld it would swing."""
    robot_spec = _welded()
    world = trial.world(scene(robot_spec, terrain=()))
    robot = world.robots["welded"]
    held = torch.tensor(robot_spec.articulation.loops[0].orientation, dtype=torch.float64)
    coupler, rocker = (robot.find_links(name)[0] for name in ("coupler", "rocker"))
    turning = moved = 0.0
    for _ in trial.advance(world, 1.0):
        orientations = robot.link_poses[0, :, 3:].double().cpu()
        turning = max(turning, float(quat_distance(orientations[rocker], quat_multiply(orientations[coupler], held))))
        moved = max(moved, abs(float(robot.joint_positions[0, 0]) - _START))
    return {"turning": turning, "moved": moved}


SCENARIOS = (
    Scenario(
        name="curved_mimic",
        group="Joints",
        question="Does a mimic joint follow a polynomial of its leader's position, and load it by its slope?",
        truth="q2 = f(q1); (I1 + f'(q1)^2 I2) v1^2 is constant",
        source="Landau and Lifshitz, Mechanics, 3rd ed., sections 2 and 38 (holonomic constraints)",
        judges=(Capability.POLYNOMIAL_MIMICS,),
        needs=(Capability.POLYNOMIAL_MIMICS,),
        run=_curved_mimic,
        metrics=(
            Metric(
                name="coupling",
                unit="rad",
                tolerance=1e-3,
                meaning="largest error of q2",
                looser_because="a thousandth of a radian is less than the play of cams",
            ),
            Metric(
                name="energy",
                unit="",
                tolerance=0.03,
                meaning="largest change within 1.5 s, relative",
                looser_because="couplings that are stiff springs take some energy",
            ),
        ),
    ),
    Scenario(
        name="welded_loop",
        group="Joints",
        question="Does a weld that closes a loop hold orientation as well as position?",
        truth="three hinges and a weld in one loop of three bars leave no way to move",
        source="Gruebler's criterion: Norton, Design of Machinery, section 2.5",
        judges=(Capability.WELD_LOOPS,),
        needs=(Capability.WELD_LOOPS,),
        run=_weld,
        metrics=(
            Metric(
                name="turning",
                unit="rad",
                tolerance=2e-3,
                meaning="largest angle by which the welded bars turn against each other, under their weight",
                looser_because="welds of plates give way by as much",
            ),
            Metric(
                name="moved",
                unit="rad",
                tolerance=2e-3,
                meaning="largest angle of the crank",
                looser_because="welds of plates give way by as much",
            ),
        ),
    ),
)
