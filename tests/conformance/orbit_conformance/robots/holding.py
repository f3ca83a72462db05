"""Check that a robot's drives hold its home position."""

from __future__ import annotations

import torch

from orbit_conformance.bodies import scene
from orbit_conformance.robots.bench import held_joints
from orbit_conformance.robots.check import Measures, RobotCheck
from orbit_conformance.scenario import Metric, Trial
from orbit_core.interfaces import Robot
from orbit_core.scene import JointType, RobotSpec

_SECONDS = 5.0
_FIRM = "an arm's own controller, with an integral part, would leave nothing; these drives are asked for 1 degree"


def _run(trial: Trial, spec: RobotSpec) -> Measures:
    world = trial.world(scene(spec, terrain=()))
    robot = world.robots[spec.name]
    joints = held_joints(spec)
    farthest = torch.zeros(len(joints), device=world.device)
    for _ in trial.advance(world, _SECONDS, every=0.05):
        farthest = torch.maximum(farthest, _from_home(robot, joints))
    slides = [spec.articulation.movable_joints[joint].type is JointType.PRISMATIC for joint in joints]
    errors = dict[str, float]()
    for name, chosen in (("angle", False), ("distance", True)):
        if chosen in slides:
            errors[name] = float(farthest[torch.tensor([slide is chosen for slide in slides])].max())
    return Measures(errors)


def _from_home(robot: Robot, joints: list[int]) -> torch.Tensor:
    """(k,) how far joints are from home, the largest of all environments."""
    return (robot.joint_positions - robot.home_positions)[:, joints].abs().amax(0)


def _spared(spec: RobotSpec) -> str:
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
    spared=_spared,
    run=_run,
)
