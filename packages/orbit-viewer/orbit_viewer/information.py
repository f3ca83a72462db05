"""What the panel says of a task."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from orbit_core.envs.environment import Environment


def task_information(environment: Environment) -> Callable[[int], Mapping[str, str]]:
    """Return a function of an environment's number: its episode's seconds, whether it succeeds now, the task's metrics.
    """
    task, world = environment.task, environment.world

    def information(index: int) -> Mapping[str, str]:
        seconds = float(task.episode_step[index]) * environment.step_dt
        success = "yes" if bool(task.success(world)[index]) else "no"
        metrics = {name: f"{float(value[index]):.3g}" for name, value in task.metrics(world).items()}
        return {"episode": f"{seconds:.2f} of {task.episode_length:g} s", "success": success, **metrics}

    return information
