"""What a policy sees: a task's observation terms, with the noise, bias and delay that they ask for."""

from __future__ import annotations

import torch
from torch import Tensor

from orbit_core.dynamics.indexing import write_rows
from orbit_core.envs.task import Task
from orbit_core.envs.terms import ObservationTerm, terms_of
from orbit_core.interfaces import ConfigurationError, World


class ObservationManager:
    """Computes the observation (N, O) of a world's present state, once per step.

    Raises:
        ConfigurationError: a term's delay cannot be.
    """

    def __init__(self, world: World, task: Task) -> None:
        self._world = world
        self._task = task
        self.terms = terms_of(task.observations, ObservationTerm)
        self._biases: dict[str, Tensor] = {}
        self._lines: dict[str, _DelayLine] = {}
        for name, term in self.terms.items():
            if term.bias_std:
                value = term.function(world, task)
                self._biases[name] = torch.zeros_like(value)
            if term.delay != (0, 0):
                self._lines[name] = _DelayLine(name, term, world, task)

    def __call__(self) -> Tensor:
        return torch.cat([self._observe(name, term) for name, term in self.terms.items()], dim=1)

    def _observe(self, name: str, term: ObservationTerm) -> Tensor:
        value = term.function(self._world, self._task)
        if term.scale != 1.0:
            value = value * term.scale
        if term.bias_std:
            value = value + self._biases[name]
        if term.noise_std:
            value = value + self._world.random.normal(tuple(value.shape[1:]), term.noise_std)
        return self._lines[name].push(value) if name in self._lines else value

    def reset(self, env_ids: Tensor | None) -> None:
        """Draw what holds for an episode, by index or mask."""
        for name, bias in self._biases.items():
            drawn = self._world.random.normal(tuple(bias.shape[1:]), self.terms[name].bias_std, env_ids)
            write_rows(bias, drawn, env_ids)
        for line in self._lines.values():
            line.reset(env_ids)


class _DelayLine:
    """Holds measurements back by the steps that each environment draws at reset."""

    def __init__(self, name: str, term: ObservationTerm, world: World, task: Task) -> None:
        self._fewest, self._most = term.delay
        if not 0 <= self._fewest <= self._most:
            raise ConfigurationError(
                f"the delay of observation '{name}' must be 0 <= fewest <= most steps, not {term.delay}"
            )
        self._world = world
        value = term.function(world, task)
        self._history = value.new_zeros(len(value), self._most + 1, value.shape[1])
        """(N, steps, k), the newest first."""
        self._steps = torch.zeros(len(value), dtype=torch.int64, device=value.device)
        self._fresh = torch.ones(len(value), dtype=torch.bool, device=value.device)
        """(N,) whose episode has measured nothing yet."""

    def reset(self, env_ids: Tensor | None) -> None:
        drawn = self._world.random.integers(self._fewest, self._most, env_ids)
        write_rows(self._steps, drawn, env_ids)
        write_rows(self._fresh, 1.0, env_ids)

    def push(self, value: Tensor) -> Tensor:
        newest = value[:, None]
        shifted = torch.cat((newest, self._history[:, :-1]), dim=1)
        history = torch.where(self._fresh[:, None, None], newest, shifted)
        rows = self._world.masking.rows(None)  # the others have measured in this step already
        write_rows(self._history, history, rows)
        write_rows(self._fresh, 0.0, rows)
        return self._history.gather(1, self._steps[:, None, None].expand_as(newest)).squeeze(1)
