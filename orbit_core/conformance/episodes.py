"""The first episode of every environment of a task, run, summed up and recorded."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import torch
from torch import Tensor

from orbit_core.conformance.estimates import Estimate, mean, proportion
from orbit_core.conformance.recording import Recording, Tracker
from orbit_core.envs import make
from orbit_core.envs.environment import EpisodeEnd


@dataclass(frozen=True)
class TaskResult:
    """What one episode in each environment came to."""

    task: str
    backend: str
    seed: int
    fields: Mapping[str, Any]
    """Of the task, where they differ from its defaults."""
    num_envs: int
    success: Estimate
    """Rate in [0, 1]."""
    metrics: dict[str, Estimate]
    """Means by name; the first leads."""
    episode_return: Estimate
    seconds_to_success: Estimate | None
    """Until the goal is reached for good, over the episodes that succeed; None if none does."""


class FirstEpisodes:
    """Runs each environment's first episode and keeps what it came to; closes the environment in the end."""

    def __init__(
        self,
        task: str,
        backend: str,
        num_envs: int,
        seed: int,
        fields: Mapping[str, Any],
        device: str,
        settings: Mapping[str, Any] | None,
    ) -> None:
        self._task, self._seed, self._fields = task, seed, dict(fields)
        self.environment = environment = make(task, num_envs, backend, device, seed, settings=settings, **fields)
        like = {"size": (num_envs,), "device": environment.device}
        self._running = torch.ones(**like, dtype=torch.bool)
        self._success = torch.zeros(**like, dtype=torch.bool)
        self._held_since = torch.zeros(**like, dtype=torch.int64)
        self._lengths = torch.zeros(**like, dtype=torch.int64)
        self._returns = torch.zeros(**like)
        self._metrics: dict[str, Tensor] = {}
        self._actions: list[Tensor] = []

    def __enter__(self) -> FirstEpisodes:
        return self

    def __exit__(self, *_: object) -> None:
        self.environment.close()

    def run(self, act: Callable[[int], Tensor], tracked_envs: int) -> None:
        """Step with the action that ``act`` gives for each step's number until all first episodes are over."""
        environment = self.environment
        environment.reset()
        self._tracker = Tracker(environment.world, tracked_envs)
        for step in range(environment.max_episode_steps):
            self._tracker.add(self._running)
            action = act(step)
            self._actions.append(action.cpu().clone())
            *_, info = environment.step(action)
            held = environment.task.success(environment.world)  # of those that go on; the others' follows
            if "final" in info:
                held = held.index_put((info["final"].env_ids,), info["final"].success)
            self._held_since.masked_fill_(self._running & ~held, step + 1)
            self._success = torch.where(self._running, held, self._success)
            if "final" in info:
                self._end(info["final"])
            if not bool(self._running.any()):
                return

    def _end(self, end: EpisodeEnd) -> None:
        first = self._running[end.env_ids]
        ids = end.env_ids[first]
        self._running[ids] = False
        self._lengths[ids] = end.steps[first]
        for values in end.rewards.values():
            self._returns[ids] += values[first]
        for name, values in end.metrics.items():
            self._metrics.setdefault(name, torch.zeros_like(self._returns))[ids] = values[first]

    def result(self) -> TaskResult:
        """Summed up."""
        environment = self.environment
        seconds = (self._held_since[self._success] + 1) * environment.step_dt
        return TaskResult(
            task=self._task,
            backend=environment.world.backend,
            seed=self._seed,
            fields=self._fields,
            num_envs=environment.num_envs,
            success=proportion(int(self._success.sum()), environment.num_envs),
            metrics={name: mean(values.tolist()) for name, values in self._metrics.items()},
            episode_return=mean(self._returns.tolist()),
            seconds_to_success=mean(seconds.tolist()) if len(seconds) else None,
        )

    def recording(self) -> Recording:
        """What was done and where things went."""
        return Recording(
            task=self._task,
            backend=self.environment.world.backend,
            seed=self._seed,
            fields=self._fields,
            step_dt=self.environment.step_dt,
            actions=torch.stack(self._actions).numpy(),
            lengths=self._lengths.cpu().numpy(),
            tracks=self._tracker.tracks(),
        )
