"""Paths keep off obstacles at every millimetre, timings keep to their limits at every sample, and are followed."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
import torch

from orbit_core.actions import JointPositionConfig
from orbit_core.agent import AgentGraph, Edge, FunctionNode
from orbit_core.interfaces import ConfigurationError, PlanningError, Port
from orbit_core.scene import Box, ObjectSpec, Pose, Shape, single_link
from orbit_motion.planning import JointPlanner, PlannerConfig, TrajectoryFollower, jerk_limited, time_optimal
from orbit_motion.planning.follower import JointTrajectory
from tests.motion.servo_world import BACKENDS, Held, held

LIMITS = np.array([2.0, 1.0, 3.0]), np.array([4.0, 6.0, 5.0]), np.array([40.0, 30.0, 60.0])
WAYPOINTS = np.array([[0.0, 0.0, 0.0], [0.8, -0.3, 0.5], [0.2, 0.6, -0.4]])


def wall() -> ObjectSpec:
    """A board between the two sides of an arm."""
    body = single_link("wall", Shape(Box((0.2, 0.02, 0.25))), 1.0, np.eye(3))
    return ObjectSpec(name="wall", articulation=body, fixed_base=True, pose=Pose((0.5, 0.35, 0.25)))


def beside_the_wall(backend: str) -> tuple[Held, torch.Tensor, torch.Tensor]:
    """An arm, and joint positions on either side."""
    arm = held(JointPositionConfig(), backend, num_envs=1, objects=(wall(),))
    left = arm.robot.home_positions.clone()
    left[0], right = 1.3, arm.robot.home_positions.clone()
    right[0] = -0.1
    arm.robot.set_joint_state(left[None])
    return arm, left[:7], right[:7]


@pytest.mark.parametrize("backend", BACKENDS)
def test_a_plan_goes_around_and_never_touches(backend: str) -> None:
    arm, left, right = beside_the_wall(backend)
    planner = JointPlanner(arm.world, arm.robot, arm.generator.joints)
    straight = left + torch.linspace(0.0, 1.0, 200)[:, None] * (right - left)
    assert planner.clearances(straight).min() < -0.02  # the wall is in the way
    path = planner.plan(right)
    torch.testing.assert_close(path[[0, -1]], torch.stack((left, right)), atol=1e-4, rtol=0.0)
    fine = [a + torch.linspace(0.0, 1.0, 3500)[:, None] * (b - a) for a, b in itertools.pairwise(path)]
    dense = torch.cat(fine)
    assert (dense[1:] - dense[:-1]).abs().max() * 0.9 < 1e-3  # m that the hand moves between two checks
    assert planner.clearances(dense).min() > 0.0
    speeds = np.array([joint.velocity_limit for joint in arm.robot.joints[:7]])
    timed = time_optimal(path, speeds, 5.0, 0.008)
    assert planner.clearances(torch.as_tensor(timed.positions)).min() > 0.0
    arm.world.close()


def test_what_stands_against_a_plan_is_told() -> None:
    arm, _, right = beside_the_wall(BACKENDS[0])
    planner = JointPlanner(arm.world, arm.robot, arm.generator.joints)
    inside = right.clone()
    inside[0] = 0.6
    with pytest.raises(
        PlanningError, match=r"at the goal 'robot' has -0.* m of the margin of 0.01 m free to 'wall', from"
    ):
        planner.plan(inside)
    beyond = right.clone()
    beyond[3] = 0.5
    with pytest.raises(PlanningError, match=r"the goal has joint 'panda_joint4' at 0.500, outside its limits"):
        planner.plan(beyond)
    hasty = JointPlanner(arm.world, arm.robot, arm.generator.joints, PlannerConfig(time_limit=1e-9))
    with pytest.raises(PlanningError, match=r"no path for 'robot' in 1e-09 s"):
        hasty.plan(right)
    arm.world.close()


def test_fingers_that_hold_each_other_are_no_obstacle_to_the_arm() -> None:
    arm, left, right = beside_the_wall(BACKENDS[0])
    closed = torch.zeros(1, 2)
    arm.robot.set_joint_state(closed, joints=arm.robot.find_joints("panda_finger.*"))
    planner = JointPlanner(arm.world, arm.robot, arm.generator.joints)
    torch.testing.assert_close(planner.plan(right)[0], left, atol=1e-4, rtol=0.0)
    arm.world.close()


def test_timings_keep_to_their_limits_at_every_sample() -> None:
    speeds, rates, jerks = LIMITS
    dt = 0.002
    fast, smooth = time_optimal(WAYPOINTS, speeds, rates, dt), jerk_limited(WAYPOINTS, speeds, rates, jerks, dt)
    for trajectory in (fast, smooth):
        assert (np.abs(trajectory.velocities) <= speeds * 1.001).all()
        accelerations = np.diff(trajectory.velocities[:-1], axis=0) / dt
        assert (np.abs(accelerations) <= rates * 1.02).all()
        np.testing.assert_allclose(trajectory.positions[[0, -1]], WAYPOINTS[[0, -1]], atol=1e-6)
        np.testing.assert_allclose(trajectory.velocities[[0, -1]], 0.0, atol=1e-6)
        moved = np.diff(trajectory.positions[:-1], axis=0) / dt
        np.testing.assert_allclose(moved, (trajectory.velocities[1:-1] + trajectory.velocities[:-2]) / 2, atol=0.02)
    thirds = np.diff(smooth.velocities, 2, axis=0) / dt**2
    inner = np.abs(thirds) <= jerks * 1.05
    assert inner.mean(0).min() > 0.98  # all but where one line ends and the next begins, between two samples
    # One joint alone, from rest to rest, at an acceleration limit: t = 2 sqrt(d / a).
    alone = time_optimal(np.array([[0.0], [1.0]]), 100.0, 4.0, dt)
    assert alone.duration == pytest.approx(2.0 * np.sqrt(1.0 / 4.0), abs=2 * dt)
    # With jerk alone to limit: t = 4 cbrt(d / (2 j)).
    jerky = jerk_limited(np.array([[0.0], [1.0]]), 100.0, 100.0, 32.0, dt)
    assert jerky.duration == pytest.approx(4.0 * (1.0 / 64.0) ** (1.0 / 3.0), abs=2 * dt)


def test_a_path_that_cannot_be_timed_is_told() -> None:
    with pytest.raises(PlanningError, match=r"two or more points of finite positions \(P, k\), not \(1, 3\)"):
        time_optimal(WAYPOINTS[:1], 1.0, 1.0, 0.01)
    with pytest.raises(ConfigurationError, match="must be above zero"):
        jerk_limited(WAYPOINTS, 1.0, 0.0, 1.0, 0.01)
    with pytest.raises(PlanningError, match="all points of the path are the same"):
        time_optimal(WAYPOINTS[[0, 0]], 1.0, 1.0, 0.01)


@pytest.mark.parametrize("backend", BACKENDS)
def test_a_node_at_its_own_rate_takes_each_arm_along_its_trajectory(backend: str) -> None:
    arm = held(JointPositionConfig(), backend)
    joints, robot = arm.generator.joints, arm.robot
    home = robot.home_positions[joints].double().numpy()
    goal = home + 0.3
    trajectory = time_optimal(np.stack((home, goal)), 1.0, 2.0, 0.01)
    node = TrajectoryFollower("follower", robot, joints, 62.5)
    node.reset()

    def act(inputs: dict[str, torch.Tensor]) -> dict[str, torch.Tensor]:
        robot.set_position_targets(inputs["position_targets"], joints)
        robot.set_velocity_targets(inputs["velocity_targets"], joints)
        return {}

    ports = (Port("position_targets", (7,)), Port("velocity_targets", (7,)))
    act_node = FunctionNode("act", act, inputs=ports)  # pyright: ignore[reportArgumentType]
    edges = [Edge(f"follower.{port.name}", f"act.{port.name}") for port in ports]
    agent = AgentGraph([node, act_node], edges, rate=125.0)
    node.load({1: trajectory})
    assert node.finished.tolist() == [True, False]
    worst = 0.0
    for step in range(200):
        agent.step()
        arm.world.step(4)
        if step * 0.008 < trajectory.duration:
            at = min(round(step * 0.008 / 0.01), len(trajectory.positions) - 1)
            worst = max(worst, float(np.abs(robot.joint_positions[1, joints].numpy() - trajectory.positions[at]).max()))
    assert node.finished.all()
    positions = robot.joint_positions[:, joints].double().numpy()
    np.testing.assert_allclose(positions, np.stack((home, goal)), atol=5e-3)
    assert worst < 0.05
    with pytest.raises(ConfigurationError, match="moves 7 joints, but the trajectory of environment 0 is of 3"):
        node.load({0: JointTrajectory(0.01, WAYPOINTS, WAYPOINTS)})
    arm.world.close()
