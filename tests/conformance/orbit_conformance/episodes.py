"""The first episode of every environment of a task, run, summed up and recorded."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import torch
from torch import Tensor

from orbit_conformance.recording import EpisodeRecorder, Recording
from orbit_core.envs import Environment, make
from orbit_core.envs.actors import Actor
from orbit_core.envs.environment import EpisodeEnd
from orbit_core.envs.premises import PremiseCheck
from orbit_core.rollout.estimates import Estimate, mean
from orbit_core.rollout.stepping import EpisodeCounter, StepObserver, roll_out


@dataclass(frozen=True)
class TaskResult:
    """The success rate and the metrics of one episode in each environment."""

    task: str
    """Name of the task."""
    backend: str
    """Name of the backend."""
    seed: int
    """Seed of the random streams."""
    fields: Mapping[str, Any]
    """Fields of the task that differ from its defaults."""
    num_envs: int
    """Number of environments, one episode in each."""
    success: Estimate
    """Success rate in [0, 1]."""
    metrics: dict[str, Estimate]
    """Mean of each metric by name; the first is the leading metric."""
    episode_return: Estimate
    """Mean sum of an episode's rewards."""
    seconds_to_success: Estimate | None
    """Time until the goal is reached for good, over the episodes that succeed; None if none does."""
    premises: tuple[PremiseCheck, ...] = ()
    """What the task takes for granted of an episode's start, and in how many sampled starts it does not hold here."""
    expert_success: float = 0.0
    """Success rate that the task's expert is held to."""

    @property
    def shortfall(self) -> str:
        """Reason of an expert's failure: its whole success interval is below the required rate; empty if it is not."""
        if self.success.high >= self.expert_success:
            return ""
        return f"success is {self.success.percent()}, below {self.expert_success:g}"


class _SuccessTimes(StepObserver):
    """Since which step the goal of each environment's first episode has been held. Stands before the counter."""

    def __init__(self, environment: Environment, counter: EpisodeCounter) -> None:
        self._environment = environment
        self._counter = counter
        self._step = 0
        self.held_since = torch.zeros(environment.num_envs, dtype=torch.int64, device=environment.device)
        """(N,) steps of the environment."""

    def after_step(self, action: Tensor, info: Mapping[str, EpisodeEnd]) -> None:
        environment = self._environment
        self._step += 1
        held = environment.task.success(environment)  # of those that go on; the others' follows
        # An episode that ended has been reset by now: its success is in the final information.
        if "final" in info:
            held = held.index_put((info["final"].env_ids,), info["final"].success)
        self.held_since.masked_fill_(self._counter.running & ~held, self._step)


class FirstEpisodes:
    """Runner of each environment's first episode that keeps the results; closes the environment in the end."""

    def __init__(
        self,
        task: str,
        backend: str,
        num_envs: int,
        seed: int,
        fields: Mapping[str, Any],
        device: str,
        settings: Mapping[str, Any] | None,
        renderer: str | None = None,
    ) -> None:
        self._task, self._seed, self._fields = task, seed, dict(fields)
        common = (num_envs, backend, device, seed, renderer, settings)
        self.environment = environment = make(task, *common, **fields)
        """Environment whose episodes are run."""
        self._counter = EpisodeCounter(num_envs, num_envs, environment.device)
        self._times = _SuccessTimes(environment, self._counter)

    def __enter__(self) -> FirstEpisodes:
        return self

    def __exit__(self, *_: object) -> None:
        self.environment.close()

    def run(self, actor: Actor, tracked_envs: int) -> None:
        """Step until all first episodes are over."""
        self.environment.reset()
        self._recorder = EpisodeRecorder(self.environment, self._counter, tracked_envs)
        observers = (self._recorder, self._times, self._counter)
        roll_out(self.environment, actor, observers, lambda: self._counter.complete)

    def result(self) -> TaskResult:
        """Success rate, metrics and times of all first episodes."""
        environment, episodes = self.environment, self._counter.episodes()
        seconds = (self._times.held_since[episodes.success] + 1) * environment.step_dt
        return TaskResult(
            task=self._task,
            backend=environment.world.backend,
            seed=self._seed,
            fields=self._fields,
            num_envs=environment.num_envs,
            success=episodes.success_rate,
            metrics={name: mean(values.tolist()) for name, values in episodes.metrics.items()},
            episode_return=mean(episodes.returns.tolist()),
            seconds_to_success=mean(seconds.tolist()) if len(seconds) else None,
            premises=environment.premises.checks,
            expert_success=environment.task.metadata.expert_success,
        )

    def recording(self) -> Recording:
        """The recorded actions and trajectories."""
        return self._recorder.recording(self._task, self._seed, self._fields)
