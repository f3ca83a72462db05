"""Tasks of cloth and rope: their experts reach the goal, holding by friction alone."""

from __future__ import annotations

import pytest

from orbit_core.envs import make


@pytest.mark.parametrize(("task", "num_envs"), [("Rope-Reshaping", 4), ("Cloth-Lifting", 2), ("Flag-Hoisting", 2)])
def test_an_expert_reaches_the_goal(task: str, num_envs: int) -> None:
    environment = make(task, num_envs, "mujoco", seed=0)
    expert = environment.task.expert(environment.world)
    environment.reset(seed=0)
    for _ in range(environment.max_episode_steps - 1):
        environment.step(expert.compute({})["action"])
    assert environment.task.success(environment.world).all()
    environment.close()
