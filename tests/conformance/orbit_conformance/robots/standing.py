"""Check that a robot with a free base stands where it is put, its drives holding home."""

from __future__ import annotations

import torch

from orbit_assets.audit.robots.postures import lowest_point
from orbit_conformance.bodies import scene
from orbit_conformance.robots.bench import held_joints
from orbit_conformance.robots.check import Measures, RobotCheck
from orbit_conformance.scenario import Metric, Trial
from orbit_core.dynamics.transforms import quat_rotate
from orbit_core.interfaces import World
from orbit_core.scene import RobotSpec

# Seconds: when it is to be at rest, and until when it is to stay so.
_SETTLE, _STAND = 5.0, 10.0
# m: a root that lies lower, as that of a wheeled base does on the ground, counts as that high.
_LOWEST = 0.25


def _run(trial: Trial, spec: RobotSpec) -> Measures:
    world = trial.world(scene(spec))
    robot = world.robots[spec.name]
    joints = held_joints(spec)
    lowest = lowest_point(spec)
    standing = spec.pose.position[2] - (0.0 if lowest is None else lowest)
    trial.step(world, trial.steps(_SETTLE))
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
