"""A state is copied between worlds, and a policy that tries actions out in copies swings a pole up."""

from __future__ import annotations

import pytest
import torch

from orbit_core.backends import backend_names
from orbit_core.dynamics.kinematics import KinematicTree
from orbit_core.dynamics.transforms import pose_inverse, pose_multiply
from orbit_core.envs import Environment, make
from orbit_core.interfaces import ArgumentError, ConfigurationError
from orbit_core.mdp import common
from orbit_motion.experts.mppi import Mppi, MppiConfig
from orbit_motion.full_ik import FullIk
from orbit_tasks.cartpole import state

BACKENDS = [name for name in ("mujoco", "bullet") if name in backend_names()]


def swing_up(num_envs: int, backend: str) -> Environment:
    """A pole that hangs still, moved at 25 Hz."""
    return make("Cartpole-Swing-Up", num_envs, backend, decimation=8, spread=(0.0, 0.0, 0.0, 0.0))


@pytest.mark.parametrize("backend", BACKENDS)
def test_a_pole_is_swung_up_and_held(backend: str) -> None:
    environment, model = swing_up(1, backend), swing_up(48, BACKENDS[0])
    environment.reset(seed=0)
    policy = Mppi(environment, model, MppiConfig(horizon=30, noise=0.6))
    heights = []
    for _ in range(50):
        environment.step(policy.compute({})["action"])
        heights.append(float(state(environment)[0, 1].cos()))
    assert heights[0] < -0.95
    assert min(heights[-8:]) > 0.85
    environment.close()
    model.close()


def test_a_cube_is_lifted_by_the_tasks_rewards_alone() -> None:
    environment, model = (make("Lift", count, backend=BACKENDS[0], action="ik_relative") for count in (1, 64))
    environment.reset(seed=0)
    robot, cube = environment.world.robots["robot"], environment.world.objects["cube"]
    tree, effector = KinematicTree(robot.spec.articulation), robot.spec.end_effector
    arm = robot.find_joints(*effector.arm_joints)
    above = cube.root_pose[:, :3] + torch.tensor([0.0, 0.0, 0.04])
    local = pose_multiply(pose_inverse(robot.root_pose), common.pointing_down(above))
    solver = FullIk(tree, effector.frame, arm, robot.position_limits, robot.home_positions)
    robot.set_joint_state(solver.solve(local, robot.joint_positions).positions, joints=arm)
    policy = Mppi(environment, model, MppiConfig(horizon=16, noise=0.5, correlation=0.8))
    for _ in range(28):
        environment.step(policy.compute({})["action"])
    assert cube.root_pose[0, 2] > 0.06  # from 0.025
    environment.close()
    model.close()


@pytest.mark.parametrize("backend", BACKENDS)
def test_what_follows_a_copied_state_is_what_follows_the_state(backend: str) -> None:
    first, second = make("Lift", num_envs=2, backend=backend), make("Lift", num_envs=4, backend=backend)
    first.reset(seed=1)
    second.reset(seed=2)
    random = torch.Generator().manual_seed(0)
    for _ in range(10):
        first.step(2.0 * torch.rand(2, first.action_size, generator=random) - 1.0)
    second.world.copy_state(1, torch.tensor([0, 3]), first.world)
    states = [[*world.robots.values(), *world.objects.values()] for world in (first.world, second.world)]
    for _ in range(2):
        for here, there in zip(*states, strict=True):
            for name in ("link_poses", "link_velocities", "joint_positions", "joint_velocities"):
                expected = getattr(here, name)[1].expand(2, *getattr(here, name).shape[1:])
                torch.testing.assert_close(getattr(there, name)[[0, 3]], expected, atol=2e-3, rtol=1e-3)
        first.world.step(20)
        second.world.step(20)
    second.world.copy_state(0, torch.tensor([1]))  # within one world
    torch.testing.assert_close(second.world.robots["robot"].link_poses[1], second.world.robots["robot"].link_poses[0])
    first.close()
    second.close()


def test_what_is_no_copy_or_no_model_is_refused() -> None:
    environment, other = swing_up(2, BACKENDS[0]), make("Reach", num_envs=4, backend=BACKENDS[0])
    with pytest.raises(ArgumentError, match="worlds of one scene: the names of links and joints differ"):
        environment.world.copy_state(0, None, other.world)
    with pytest.raises(ArgumentError, match="source"):
        environment.world.copy_state(2)
    with pytest.raises(ConfigurationError, match="the model is of task Reach with 8 components of action"):
        Mppi(environment, other)
    with pytest.raises(ConfigurationError, match="a model of 2 environments gives 2 no equal number of samples"):
        Mppi(environment, swing_up(2, BACKENDS[0]))
    environment.close()
    other.close()
