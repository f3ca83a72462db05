"""The loop of a rollout: an actor acts, the environment steps, observers look on."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

from torch import Tensor

if TYPE_CHECKING:
    from orbit_core.envs.actors import Actor
    from orbit_core.envs.captured_step import StepResult
    from orbit_core.envs.environment import Environment
    from orbit_core.envs.episode import EpisodeEnd


class StepObserver:
    """Looks on while an environment is stepped. Override what is of interest."""

    def before_step(self) -> None:
        """Called before the actor acts."""

    def stepped(self, action: Tensor, result: StepResult) -> None:
        """Called after each step; hands on to :meth:`after_step`, which most observers can do with.

        Args:
            action: (N, A) that was taken.
            result: all that the step returned.
        """
        self.after_step(action, result[4])

    def after_step(self, action: Tensor, info: Mapping[str, EpisodeEnd]) -> None:
        """Called after each step.

        Args:
            action: (N, A) that was taken.
            info: that the step returned.
        """


@dataclass(frozen=True)
class Pace:
    """How fast an environment was stepped."""

    env_steps: int
    """Steps of single environments."""
    seconds: float
    """Spent acting and stepping; observers left out."""

    @property
    def env_steps_per_second(self) -> float:
        """Steps of single environments in a second."""
        return self.env_steps / self.seconds


def roll_out(
    environment: Environment,
    actor: Actor,
    observers: Sequence[StepObserver],
    complete: Callable[[], bool] = lambda: False,
    max_steps: float = math.inf,
) -> Pace:
    """Step an environment from its present state until all is done.

    Args:
        environment: to step.
        actor: gives the actions.
        observers: called before and after each step, in their order.
        complete: asked before each step whether all is done.
        max_steps: number of steps after which to end in any case.
    """
    steps, seconds = 0, 0.0
    while steps < max_steps and not complete():
        for observer in observers:
            observer.before_step()
        begin = time.perf_counter()
        action = actor.act()
        result = environment.step(action)
        seconds += time.perf_counter() - begin
        steps += 1
        for observer in observers:
            observer.stepped(action, result)
    return Pace(steps * environment.num_envs, seconds)
