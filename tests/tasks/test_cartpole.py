"""Cartpole's expert; what the tasks say of themselves; and tasks that have no expert."""

from __future__ import annotations

import math

import pytest
import torch

from orbit_conformance.jobs import Kind, plan
from orbit_conformance.settings import choose
from orbit_core.envs import make
from orbit_core.interfaces import ConfigurationError
from orbit_tasks import cartpole, running
from tests.tasks.experts import episode


@pytest.mark.parametrize("task", ["Cartpole-Balance", "Cartpole-Swing-Up"])
def test_the_pole_stands_at_the_end(task: str) -> None:
    environment, success = episode(task, "mujoco", 4)
    angle, cart = environment.task.metrics(environment).values()
    environment.close()
    assert success.all()
    assert angle.max() < 0.01
    assert cart.max() < 0.02


def test_episodes_begin_where_the_tasks_say_and_end_where_the_pole_topples() -> None:
    hanging, standing = (make(f"Cartpole-{name}", 8, "mujoco", seed=0) for name in ("Swing-Up", "Balance"))
    hanging.reset(seed=0)
    assert (cartpole.state(hanging)[:, 1].abs() > math.pi - 0.31).all()
    standing.reset(seed=0)
    assert (cartpole.state(standing)[:, 1].abs() < 0.11).all()
    ended = torch.zeros(8, dtype=torch.bool)
    for _ in range(60):
        *_, terminated, _, _ = standing.step(torch.ones(8, 1))
        ended |= terminated
    assert ended.all()
    with pytest.raises(ConfigurationError, match="the expert gives the cart's effort"):
        make("Cartpole-Balance", 1, "mujoco", actions=None, action="joint_position").expert()
    with pytest.raises(ConfigurationError, match="has not the joints 'slider' and 'hinge'"):
        make("Cartpole-Balance", 1, "mujoco", robot="ur5")
    hanging.close()
    standing.close()


@pytest.mark.parametrize("task", ["Ant", "Humanoid"])
def test_the_speed_is_the_way_over_the_time(task: str) -> None:
    environment = make(task, 2, "mujoco", seed=0)
    environment.reset(seed=0)
    robot = environment.world.robots["robot"]
    begin = robot.root_pose[:, 0].clone()
    pushed = robot.root_velocity.clone()
    pushed[:, 0] = 1.0
    robot.set_root_velocity(pushed)
    for _ in range(10):
        environment.step(torch.zeros(2, environment.action_size))
    gone = (robot.root_pose[:, 0] - begin) / (10 * environment.task.physics_dt * environment.task.decimation)
    torch.testing.assert_close(environment.task.metrics(environment)["speed_m_s"], gone, atol=0.1, rtol=0.0)
    assert (running.heading(environment)[:, 0] > 0.9).all()
    with pytest.raises(ConfigurationError, match="has no scripted expert: learn it"):
        environment.expert()
    environment.close()


def test_the_suite_asks_no_expert_of_what_is_learned() -> None:
    settings = choose(backends=["mujoco"], tasks=["Ant", "Cartpole-Balance"], parts=["tasks", "throughput"], quick=True)
    jobs = [job for phase in plan(settings) for job in phase.jobs]
    assert {job.name for job in jobs if job.kind is Kind.TASK} == {"Cartpole-Balance"}
    assert {job.name for job in jobs if job.kind is Kind.THROUGHPUT} == {"Ant", "Cartpole-Balance"}
