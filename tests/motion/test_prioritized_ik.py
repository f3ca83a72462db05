"""Inverse kinematics by quadratic programs: the programs, priorities, limits, posture and singularities."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
import torch
from scipy.optimize import LinearConstraint, minimize

from orbit_core.actions import Actuate, CommandMode, MotionGenerator
from orbit_core.actions.base import speed_limited_lead
from orbit_core.dynamics.transforms import pose_error
from orbit_core.interfaces import ConfigurationError
from orbit_motion import PrioritizedIkConfig, Priority
from orbit_motion.full_ik import FullIkTermConfig
from orbit_motion.prioritized_ik import manipulability, manipulability_gradient, solve_qp
from tests.motion.servo_world import BACKENDS, held

MakeRobot = Callable[..., Any]
OPEN = torch.ones(4, dtype=torch.bool)


def test_programs_agree_with_a_general_solver() -> None:
    rng = np.random.default_rng(1)
    factor = rng.normal(size=(6, 5, 5))
    quadratic = factor @ factor.transpose(0, 2, 1) + 0.1 * np.eye(5)
    linear, matrix = (
        rng.normal(size=(6, 5)),
        np.concatenate((np.tile(np.eye(5), (6, 1, 1)), rng.normal(size=(6, 1, 5))), 1),
    )
    lower, upper = np.tile([-0.2] * 5 + [0.05], (6, 1)), np.tile([0.3] * 5 + [0.05], (6, 1))
    found = solve_qp(*(torch.tensor(part) for part in (quadratic, linear, matrix, lower, upper)), 500).numpy()
    for p, q, a, low, high, x in zip(quadratic, linear, matrix, lower, upper, found, strict=True):
        best = minimize(
            lambda v, p=p, q=q: v @ p @ v / 2 + q @ v, np.zeros(5), jac=lambda v, p=p, q=q: p @ v + q,
            constraints=LinearConstraint(a, low, high), method="SLSQP", options={"ftol": 1e-12},
        )  # fmt: skip
        np.testing.assert_allclose(x, best.x, atol=1e-4)


def test_the_gradient_of_the_manipulability_is_that_of_finite_differences(kinematic_robot: MakeRobot) -> None:
    robot = kinematic_robot()
    robot.q[:, :7] += 0.3 * torch.randn(4, 7, generator=torch.Generator().manual_seed(1))
    frame, joints = robot.spec.end_effector.frame, list(range(7))
    tree = type(robot.tree)(robot.spec.articulation, dtype=torch.float64)
    root, start = robot.root.double(), robot.q.double()

    def logarithm(positions: torch.Tensor) -> torch.Tensor:
        return manipulability(tree.jacobian(tree.forward(root, positions), frame)[:, :, joints]).log()

    numeric = torch.stack([logarithm(start + 1e-5 * e) - logarithm(start - 1e-5 * e) for e in torch.eye(9).double()], 1)
    torch.testing.assert_close(
        manipulability_gradient(robot.jacobian(frame, joints)), (numeric / 2e-5)[:, :7].float(), atol=2e-2, rtol=1e-2
    )


def follow(robot: Any, generator: MotionGenerator, goal: torch.Tensor, steps: int) -> torch.Tensor:
    """(N, 6) what is missing to the goal after so many steps without physics."""
    actuate = Actuate(robot, generator)
    for _ in range(steps):
        actuate.compute(generator.compute({"command": generator.encode(goal, OPEN)}))
    return pose_error(robot.frame_pose(robot.spec.end_effector.frame), goal)


def test_the_hand_holds_while_the_joints_go_home(kinematic_robot: MakeRobot) -> None:
    robot = kinematic_robot()
    generator = PrioritizedIkConfig(damping=0.01).build("ik", robot)
    free = torch.linalg.svd(robot.jacobian("panda_hand_tcp", generator.joints))[2][:, -1]
    robot.q[:, :7] += 0.6 * free  # the elbow swings aside
    goal = robot.frame_pose("panda_hand_tcp").clone()
    turned = (generator.positions - robot.home_positions[:7]).norm(dim=1)
    assert follow(robot, generator, goal, 120).abs().max() < 2e-3
    assert ((generator.positions - robot.home_positions[:7]).norm(dim=1) < 0.3 * turned).all()


def test_joints_get_away_from_singular_poses_where_the_hand_lets_them(kinematic_robot: MakeRobot) -> None:
    robot = kinematic_robot()
    frame = "panda_hand_tcp"
    config = PrioritizedIkConfig(damping=0.01, posture_gain=0.0, manipulability_gain=0.05)
    generator = config.build("ik", robot)
    robot.q[:, :7] += 1.2 * torch.linalg.svd(robot.jacobian(frame, generator.joints))[2][:, -1]
    before, goal = manipulability(robot.jacobian(frame, generator.joints)), robot.frame_pose(frame).clone()
    assert follow(robot, generator, goal, 120).abs().max() < 5e-3
    after = manipulability(robot.jacobian(frame, generator.joints))
    assert (after > 1.05 * before).all()


@pytest.mark.parametrize("priority", [Priority.POSITION, Priority.ROTATION])
def test_what_comes_first_is_had_where_not_all_can_be(kinematic_robot: MakeRobot, priority: Priority) -> None:
    robot = kinematic_robot()
    arm = ("panda_joint[1246]",)  # four joints for six components
    generator = PrioritizedIkConfig(joints=arm, priority=priority, damping=0.01, posture_gain=0.0).build("ik", robot)
    goal = robot.frame_pose("panda_hand_tcp").clone()
    if priority is Priority.POSITION:
        goal[:, :3] += torch.tensor([0.02, 0.05, -0.03])
    else:
        generator = PrioritizedIkConfig(priority=priority, damping=0.01, posture_gain=0.0).build("ik", robot)
        goal[:, 0] += 0.8  # out of reach
    missing = follow(robot, generator, goal, 150)
    first, second = missing[:, :3].norm(dim=1), missing[:, 3:].norm(dim=1)
    if priority is Priority.ROTATION:
        first, second = second, first
    assert first.max() < 3e-3
    assert second.min() > 10 * first.max()


@pytest.mark.parametrize("backend", BACKENDS)
def test_targets_keep_to_limits_of_position_and_speed(backend: str) -> None:
    arm = held(PrioritizedIkConfig(position_scale=0.5, rotation_scale=1.0, speed=0.5), backend)
    generator = arm.generator
    fastest = torch.tensor([joint.velocity_limit for joint in arm.robot.joints[:7]])
    lead = 0.5 * speed_limited_lead(arm.robot, generator.joints)
    command = torch.tensor([[0.6, 1.0, -0.4, 0.5, 0.2, -1.0], [-1.0, 0.2, 0.3, -0.5, 0.9, 1.0]])
    for _ in range(75):
        targets = generator.compute({"command": command})["position_targets"]
        assert ((targets - generator.positions).abs() <= lead + 1e-5).all()
        assert ((targets >= generator.lower_limits) & (targets <= generator.upper_limits)).all()
        arm.run(command, 8, decimation=8)
        assert (generator.velocities.abs() < 0.55 * fastest).all()
    arm.world.close()


def test_full_inverse_kinematics_takes_all_joints_there_together_or_holds_still() -> None:
    arm = held(FullIkTermConfig(), BACKENDS[0])
    goal = arm.hand()
    goal[:, :3] += torch.tensor([[0.1, 0.15, -0.1], [-0.05, -0.2, 0.1]])
    command = arm.generator.encode(goal, OPEN[:2])
    arm.run(command, 1000, decimation=20)
    assert pose_error(arm.hand(), goal).abs().max() < 5e-3
    far = FullIkTermConfig(position_scale=3.0).build("far", arm.robot)
    before = far.positions.clone()
    targets = far.compute({"command": torch.tensor([[1.0, 0, 0, 0, 0, 0]] * 2)})["position_targets"]
    torch.testing.assert_close(targets, before, atol=1e-5, rtol=0.0)
    assert far.missing[:, 0].min() > 2.0
    arm.world.close()


def test_weights_that_cannot_be_are_refused(kinematic_robot: MakeRobot) -> None:
    with pytest.raises(ConfigurationError, match="give six numbers"):
        PrioritizedIkConfig(weights=(1.0, 2.0)).build("ik", kinematic_robot())
    assert PrioritizedIkConfig().mode is CommandMode.RELATIVE
