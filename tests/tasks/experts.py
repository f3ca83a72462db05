"""Runs a task's expert for one episode in each environment."""

from __future__ import annotations

from typing import Any

from torch import Tensor

from orbit_core.envs import Environment, make
from orbit_motion.experts import Expert


def episode(
    task: str, backend: str, num_envs: int = 4, teaches: bool = False, **fields: Any
) -> tuple[Environment, Tensor]:
    """The environment, its first episodes just over, and which (N,) succeeded. Close it.

    An expert that ``teaches`` says what it would say to another who leads.

    What must not end before the time limit does not, or the episode is taken for a failure.
    """
    environment = make(task, num_envs, backend, seed=0, **fields)
    expert = environment.expert()
    if teaches:
        assert isinstance(expert, Expert)
        expert.teaches = True
    environment.reset(seed=0)
    for _ in range(environment.max_episode_steps - 1):
        _, _, terminated, truncated, _ = environment.step(expert.compute({})["action"])
        assert not (terminated | truncated).any(), "an episode ended early"
    return environment, environment.task.success(environment)
