"""Tasks of arms on bases: experts drive and reach, starts lie out of reach, and what a robot lacks is told."""

from __future__ import annotations

import pytest
import torch

from orbit_core.envs import make
from orbit_core.interfaces import ConfigurationError
from orbit_tasks import lift, mobile_lift, mobile_reach
from orbit_tasks.mobile import base_pose
from tests.tasks.experts import episode


def test_the_expert_drives_another_base_to_the_goal_and_reaches_it() -> None:
    environment, success = episode("Mobile-Reach", "mujoco", 3, robot="tiago")
    environment.close()
    assert success.all()


def test_goals_lie_beyond_the_arms_reach() -> None:
    environment = make("Mobile-Reach", 16, "mujoco", seed=1)
    environment.reset(seed=1)
    task = environment.task
    assert isinstance(task, mobile_reach.MobileReach)
    away = torch.linalg.vector_norm(environment.commands["goal"][:, :2] - base_pose(environment)[:, :2], dim=1)
    environment.close()
    assert (away >= mobile_reach.NEAREST - 1e-4).all()
    assert (away <= mobile_reach.FARTHEST + 1e-4).all()


def test_a_walking_robot_is_led_by_a_kept_policy() -> None:
    environment = make("Mobile-Reach", 2, "mujoco", robot="anymal_c_kinova_gen3")
    names = [generator.name for generator in environment.actions.generators]
    legs = environment.actions.generators[-1]
    moved = {environment.world.robots["robot"].joint_names[joint] for joint in legs.joints}
    environment.close()
    assert names == ["joint_position", "gripper", "base"]
    assert moved == {f"{leg}_{joint}" for leg in ("LF", "RF", "LH", "RH") for joint in ("HAA", "HFE", "KFE")}


def test_a_robot_without_a_base_is_refused() -> None:
    with pytest.raises(ConfigurationError, match=r"'ur10' has no base that moves.*base_omni\+ur10"):
        make("Mobile-Reach", 1, "mujoco", robot="ur10")


def test_an_action_space_that_moves_no_base_alone_has_no_expert() -> None:
    environment = make("Mobile-Reach", 1, "mujoco", action="whole_body_ik")
    with pytest.raises(ConfigurationError, match=r"drives a base by velocities.*'whole_body_ik'"):
        environment.expert()
    environment.close()


def test_cube_and_table_are_as_high_as_suits_the_arm() -> None:
    environment = make("Mobile-Lift", 2, "mujoco", seed=1)
    environment.reset(seed=1)
    task, world = environment.task, environment.world
    assert isinstance(task, mobile_lift.MobileLift)
    lowest = world.robots["robot"].spec.end_effector.workspace.low[2]
    assert environment.state.surface == pytest.approx(lowest - 0.1)
    torch.testing.assert_close(lift.cube_height(environment), torch.full((2,), environment.state.rest_height))
    assert not lift.dropped(environment).any()
    assert not lift.lifted(environment).any()
    environment.close()


def test_a_robot_that_carries_an_arm_learns_to_walk_with_its_legs_alone() -> None:
    fields = {"domain_randomization": True, "across_engines": True}
    environment = make("Velocity-Flat", 2, "mujoco", robot="anymal_c_kinova_gen3", seed=1, **fields)
    environment.reset(seed=1)
    robot = environment.world.robots["robot"]
    arm = robot.find_joints(*robot.spec.end_effector.arm_joints)
    posture, home = robot.joint_positions[:, arm].clone(), robot.home_positions[arm]
    for _ in range(10):
        environment.step(torch.zeros(2, environment.action_size))
    held = robot.joint_positions[:, arm]
    environment.close()
    assert environment.action_size == 12
    assert (posture - home).abs().amax() > 0.1
    torch.testing.assert_close(held, posture, atol=0.1, rtol=0.0)
