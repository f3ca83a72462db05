"""A pose that is out of reach is told, by how much, by every generator of poses; joints come to rest."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from types import SimpleNamespace

import pytest
import torch

from orbit_core.actions import CommandMode, DifferentialIkConfig
from orbit_core.actions.differential_ik import PoseTermConfig
from orbit_core.actions.ik import PoseFollower
from orbit_core.rollout.stepping import ReachWatch
from orbit_motion import (
    Admittance,
    AdmittanceConfig,
    CartesianImpedanceConfig,
    HybridForceMotionConfig,
    OperationalSpaceConfig,
    PrioritizedIkConfig,
    RmpFlow,
    RmpFlowConfig,
)
from orbit_motion.compliant import Compliant
from orbit_motion.full_ik import FullIkTermConfig
from tests.motion.conftest import KinematicRobot

MakeRobot = Callable[..., KinematicRobot]

TERMS = (
    DifferentialIkConfig(), PrioritizedIkConfig(), FullIkTermConfig(), OperationalSpaceConfig(),
    CartesianImpedanceConfig(), HybridForceMotionConfig(force=(False,) * 6), RmpFlowConfig(), AdmittanceConfig(),
)  # fmt: skip
AHEAD = torch.tensor([0.05, 0.5, 0.6])
"""Commands along x of the root: 0.1, 1.0 and 1.2 m ahead of home."""


def far(term: PoseTermConfig, robot: KinematicRobot) -> tuple[PoseFollower, torch.Tensor]:
    """A generator of absolute poses that was given commands, and those."""
    generator = replace(term, mode=CommandMode.ABSOLUTE, position_scale=2.0).build("it", robot)
    assert isinstance(generator, PoseFollower)
    command = torch.zeros(3, generator.command_size)
    command[:, 0] = AHEAD
    if isinstance(generator, RmpFlow | Admittance):
        generator._pose.target(command)  # all else that they do needs a world
    elif isinstance(generator, Compliant):
        generator.aim(command)
    else:
        generator.compute({"command": command})
    return generator, command


@pytest.mark.parametrize("term", TERMS, ids=lambda term: term.name)
def test_by_how_much_a_pose_is_out_of_reach_is_told(kinematic_robot: MakeRobot, term: PoseTermConfig) -> None:
    generator, _ = far(term, kinematic_robot(num_envs=3))
    missing = generator.out_of_reach()
    assert missing[0].tolist() == [0.0, 0.0]
    assert not generator.reach_problem(0)
    assert 0.5 < missing[1, 0] < 0.6
    torch.testing.assert_close(missing[2, 0] - missing[1, 0], torch.tensor(0.2), atol=0.02, rtol=0.0)
    assert f"is out of reach by {missing[1, 0]:.3f} m" in generator.reach_problem(1)


@pytest.mark.parametrize("term", TERMS[:2], ids=lambda term: term.name)
def test_joints_come_to_rest_where_the_pose_is_out_of_reach(kinematic_robot: MakeRobot, term: PoseTermConfig) -> None:
    robot = kinematic_robot(num_envs=3)
    generator, command = far(term, robot)
    before = robot.q.clone()
    for _ in range(60):
        before = robot.q.clone()
        robot.q[:, generator.joints] = generator.compute({"command": command})["position_targets"]
    assert (robot.q - before).abs().max() < 2e-3
    left = (robot.frame_pose(generator.frame) - generator.asked())[:, :3].norm(dim=1)
    torch.testing.assert_close(left, generator.out_of_reach()[:, 0], atol=0.02, rtol=0.0)


def test_a_run_tells_how_often_what_is_asked_is_out_of_reach_and_by_how_much(kinematic_robot: MakeRobot) -> None:
    robot = kinematic_robot(num_envs=3)
    generator, command = far(TERMS[0], robot)
    watch = ReachWatch(SimpleNamespace(actions=SimpleNamespace(generators=[generator])))  # pyright: ignore
    for _ in range(100):
        robot.q[:, generator.joints] = generator.compute({"command": command})["position_targets"]
        watch.after_step(command, {})
    assert watch.share == pytest.approx(2.0 / 3.0)  # of three hands one is asked for what it can reach
    assert 0.7 < watch.farthest < 0.8
    robot.v[:] = 1.0
    assert not generator.resting_off().any()
