"""Checks that a robot holds home: with its root held, and standing on the ground."""

from __future__ import annotations

import torch

from orbit_assets.audit.robots.postures import lowest_point
from orbit_conformance.bodies import scene
from orbit_conformance.robots.check import Measures, RobotCheck, held_joints
from orbit_conformance.scenario import Metric, Trial
from orbit_core.dynamics.transforms import quat_rotate
from orbit_core.interfaces import Robot, World
from orbit_core.scene import JointType, RobotSpec

_SECONDS = 5.0
_FIRM = "an arm's own controller, with an integral part, would leave nothing; these drives are asked for 1 degree"


def _run_hold(trial: Trial, spec: RobotSpec) -> Measures:
    world = trial.world(scene(spec, terrain=()))
    robot = world.robots[spec.name]
    joints = held_joints(spec)
    farthest = torch.zeros(len(joints), device=world.device)
    for _ in trial.advance(world, _SECONDS, every=0.05):
        farthest = torch.maximum(farthest, _from_home(robot, joints))
    slides = [spec.articulation.movable_joints[joint].type is JointType.PRISMATIC for joint in joints]
    errors = dict[str, float]()
    # Angles and distances have tolerances of their own; a robot may have only one kind of joint.
    for name, chosen in (("angle", False), ("distance", True)):
        if chosen in slides:
            errors[name] = float(farthest[torch.tensor([slide is chosen for slide in slides])].max())
    return Measures(errors)


def _from_home(robot: Robot, joints: list[int]) -> torch.Tensor:
    """(k,) how far joints are from home, the largest of all environments."""
    return (robot.joint_positions - robot.home_positions)[:, joints].abs().amax(0)


def _spared_from_hold(spec: RobotSpec) -> str:
    if not spec.fixed_base:
        return "its root is free: whether it stands is asked instead"
    return "" if held_joints(spec) else "no joint has a position drive"


HOLD = RobotCheck(
    name="robot_hold",
    title="holds home",
    question="Do the drives hold the home position for 5 s?",
    truth="the home position; links that touch at home do not collide",
    metrics=(
        Metric(
            name="angle",
            unit="rad",
            tolerance=0.02,
            meaning="farthest that a driven joint turns from home",
            looser_because=_FIRM,
        ),
        Metric(
            name="distance",
            unit="m",
            tolerance=0.005,
            meaning="farthest that a driven joint slides from home",
            looser_because=_FIRM,
        ),
    ),
    spared=_spared_from_hold,
    run=_run_hold,
)


# Seconds: when it is to be at rest, and until when it is to stay so.
_SETTLE, _STAND = 5.0, 10.0
# m: a root that lies lower, as that of a wheeled base does on the ground, counts as that high.
_LOWEST = 0.25


def _run(trial: Trial, spec: RobotSpec) -> Measures:
    world = trial.world(scene(spec))
    robot = world.robots[spec.name]
    joints = held_joints(spec)
    lowest = lowest_point(spec)
    # Height of the root with the lowest point of the robot on the ground.
    standing = spec.pose.position[2] - (0.0 if lowest is None else lowest)
    trial.step(world, trial.steps(_SETTLE))
    # Drives may sag when the robot is put down; from here on nothing may move.
    settled, rest = robot.joint_positions.clone(), robot.root_pose.clone()
    trial.step(world, trial.steps(_STAND - _SETTLE))
    end = robot.root_pose
    errors = {
        "tilt": float(_tilt(world, end).max()),
        "height": float((end[:, 2] - standing).abs().max()) / max(standing, _LOWEST),
        "way": float((end - rest)[:, :2].norm(dim=-1).max()),
    }
    figures = {"height lost (m)": standing - float(end[:, 2].min())}
    if joints:
        errors["joints"] = float((robot.joint_positions - settled)[:, joints].abs().max())
        figures["sag (rad)"] = float((robot.joint_positions - robot.home_positions)[:, joints].abs().max())
    return Measures(errors, figures)


def _tilt(world: World, pose: torch.Tensor) -> torch.Tensor:
    """(N,) angle between the root's z and the vertical, in rad."""
    up = torch.tensor([[0.0, 0.0, 1.0]], device=world.device).expand(len(pose), 3)
    raised = quat_rotate(pose[:, 3:], up)
    return torch.atan2(raised[:, :2].norm(dim=-1), raised[:, 2])


def _spared(spec: RobotSpec) -> str:
    if spec.fixed_base:
        return "its root is held: whether it holds home is asked instead"
    return "" if held_joints(spec) else "no joint has a position drive: nothing holds it up"


_POSTURE = "soft drives give way under the robot's own weight until they carry it"

STAND = RobotCheck(
    name="robot_stand",
    title="stands",
    question="Does a robot with a free base stand at home for 10 s, and rest after 5?",
    truth="upright, where it was put; from 5 s on nothing moves",
    metrics=(
        Metric(
            name="tilt",
            unit="rad",
            tolerance=0.1,
            meaning="angle of the root from upright after 10 s",
            looser_because=_POSTURE,
        ),
        Metric(
            name="height",
            unit="",
            tolerance=0.1,
            meaning="change of the root's height after 10 s, as a share of that at home on the ground, 0.25 m at least",
            looser_because=_POSTURE,
        ),
        Metric(
            name="way",
            unit="m",
            tolerance=0.01,
            meaning="way of the root over the ground from 5 s to 10 s",
            looser_because="a foot may creep, as the scenarios of friction tell",
        ),
        Metric(
            name="joints",
            unit="rad",
            tolerance=0.02,
            meaning="farthest that a driven joint moves from 5 s to 10 s",
            looser_because="a foot may creep, as the scenarios of friction tell",
        ),
    ),
    spared=_spared,
    run=_run,
)
