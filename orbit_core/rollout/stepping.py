"""Rollouts: an actor acts, the environment steps, observers count episodes and watch."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import torch
from torch import Tensor

from orbit_core.actions.ik import PoseFollower
from orbit_core.envs.actors import RemoteSource
from orbit_core.rollout.estimates import Estimate, proportion

if TYPE_CHECKING:
    from orbit_core.envs.actors import Actor
    from orbit_core.envs.captured_step import StepResult
    from orbit_core.envs.environment import Environment
    from orbit_core.envs.episode import EpisodeEnd

# Steps from one look to the next: searching for a pose takes as long as several steps
_EVERY = 50


class StepObserver:
    """Looks on while an environment is stepped. Override what is of interest."""

    def before_step(self) -> None:
        """Observe the environment before the actor acts."""

    def stepped(self, action: Tensor, result: StepResult) -> None:
        """Observe a step with all that it returned; most observers only need :meth:`after_step`.

        Args:
            action: (N, A) that was taken.
            result: all that the step returned.
        """
        self.after_step(action, result[4])

    # Two levels of detail, since most observers need the ends of episodes only.
    def after_step(self, action: Tensor, info: Mapping[str, EpisodeEnd]) -> None:
        """Observe a step.

        Args:
            action: (N, A) that was taken.
            info: that the step returned.
        """


@dataclass(frozen=True)
class Pace:
    """Stepping rate of an environment."""

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
        # Only acting and stepping are timed: filming and counting are not part of the pace.
        begin = time.perf_counter()
        action = actor.act()
        result = environment.step(action)
        seconds += time.perf_counter() - begin
        steps += 1
        for observer in observers:
            observer.stepped(action, result)
    return Pace(steps * environment.num_envs, seconds)


@dataclass(frozen=True, eq=False)
class Episodes:
    """Results of n episodes, ordered by environment, then by the time at which they ended."""

    env_ids: Tensor
    """(n,) int64"""
    success: Tensor
    """(n,) bool"""
    steps: Tensor
    """(n,) int64, of the environment."""
    returns: Tensor
    """(n,) sums of the rewards."""
    metrics: dict[str, Tensor]
    """(n,) each, by name; the first leads."""

    @property
    def success_rate(self) -> Estimate:
        """Success rate in [0, 1], with its 95 % interval."""
        return proportion(int(self.success.sum()), len(self.success))


class EpisodeCounter(StepObserver):
    """Counts the first episodes of each environment.

    Environment i counts its first ``episodes // num_envs`` episodes, and one more if i < ``episodes % num_envs``. A
    race for the first ``episodes`` to end would prefer short episodes to long ones, and so failures to successes or
    the reverse.

    Args:
        episodes: to count.
        num_envs: of the environment.
        device: of the environment.
        actor: that acts; episodes in which it got no answer count as failures.
    """

    def __init__(
        self, episodes: int, num_envs: int, device: torch.device | str = "cpu", actor: Actor | None = None
    ) -> None:
        self._remote = actor if isinstance(actor, RemoteSource) else None
        ids = torch.arange(num_envs, device=device)
        # Environments with a lower index take the remainder.
        self._left = episodes // num_envs + (ids < episodes % num_envs).long()
        self._counted: list[Episodes] = []
        self.wanted = episodes
        """Episodes to count."""
        self.counted = 0
        """Episodes that have been counted."""
        self.unanswered = 0
        """Of these, episodes in which the actor got no answer."""

    @property
    def complete(self) -> bool:
        """True if every requested episode has finished."""
        return self.counted == self.wanted

    @property
    def running(self) -> Tensor:
        """Mask (N,) of the environments in which episodes are still to be counted."""
        return self._left > 0

    def after_step(self, action: Tensor, info: Mapping[str, EpisodeEnd]) -> None:
        """Count the episodes that ended in a step."""
        if "final" in info:
            self.add(info["final"])

    def add(self, end: EpisodeEnd) -> None:
        """Count those of the episodes that are within their environment's share."""
        # Later episodes of an environment that has its share are dropped.
        rows = self.running[end.env_ids].nonzero().squeeze(-1)
        if not len(rows):
            return
        end = end.only(rows)
        self._left[end.env_ids] -= 1
        returns = sum(end.rewards.values(), torch.zeros_like(end.steps, dtype=torch.float32))
        success = end.success
        if self._remote is not None:
            unanswered = torch.tensor(self._remote.unanswered, device=success.device)[end.env_ids]
            success = success & ~unanswered
            self.unanswered += int(unanswered.sum())
        self._counted.append(Episodes(end.env_ids, success, end.steps, returns, end.metrics))
        self.counted += len(rows)

    def episodes(self) -> Episodes:
        """Return the results of the counted episodes, of which there must be at least one."""
        parts = self._counted
        env_ids = torch.cat([part.env_ids for part in parts])
        # Stable, so that episodes of one environment keep their order in time.
        order = env_ids.argsort(stable=True)
        return Episodes(
            env_ids=env_ids[order],
            success=torch.cat([part.success for part in parts])[order],
            steps=torch.cat([part.steps for part in parts])[order],
            returns=torch.cat([part.returns for part in parts])[order],
            metrics={name: torch.cat([part.metrics[name] for part in parts])[order] for name in parts[0].metrics},
        )


class ReachWatch(StepObserver):
    """Looks now and then whether a hand rests away from what is asked of it, for it is out of reach.

    Args:
        environment: that is stepped; what it moves by poses is watched.
    """

    def __init__(self, environment: Environment) -> None:
        self._followers = [item for item in environment.actions.generators if isinstance(item, PoseFollower)]
        self._steps, self._looks, self._found = 0, 0, 0
        self.farthest = 0.0
        """m by which the nearest pose misses, at most."""

    @property
    def share(self) -> float:
        """Share of the looks at hands that found the target out of reach, in [0, 1]."""
        return self._found / max(self._looks, 1)

    def after_step(self, action: Tensor, info: Mapping[str, EpisodeEnd]) -> None:
        self._steps += 1
        if self._steps % _EVERY:
            return
        for follower in self._followers:
            self._looks += follower.num_envs
            # A hand that still moves towards its target is not out of reach.
            resting = follower.resting_off()
            if bool(resting.any()):
                missing = follower.out_of_reach()[resting]
                self._found += int(missing.any(1).sum())
                self.farthest = max(self.farthest, float(missing[:, 0].max()))
