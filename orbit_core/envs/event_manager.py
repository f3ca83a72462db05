"""Event manager: runs a task's events when they are due."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import replace
from typing import TYPE_CHECKING

import torch
from torch import Tensor

from orbit_core.dynamics.indexing import is_mask, write_rows
from orbit_core.envs.terms import EventTerm, EventTime, terms_of
from orbit_core.interfaces import ConfigurationError, World

if TYPE_CHECKING:
    from orbit_core.envs.environment import Environment


class EventManager:
    """Runs the events of a task.

    Args:
        env: whose task has the terms.
        memory: gives the tensors that the state and the agent remember, by name; events write them.

    Raises:
        ConfigurationError: an interval cannot be.
    """

    def __init__(self, env: Environment, memory: Callable[[], Mapping[str, Tensor]]) -> None:
        self._env = env
        self._world = env.world
        self._memory = memory
        self._all = torch.arange(env.num_envs, device=env.device)
        self._timers: dict[str, _Timer] = {}
        # Copies of the startup's terms, once they have happened.
        self._happened: list[EventTerm] | None = None
        self._read()

    def refresh(self) -> None:
        """Take the terms that the task has now; an interval holds from an environment's next draw on.

        Raises:
            ConfigurationError: an event of :attr:`EventTime.STARTUP` is another, or an interval cannot be.
        """
        timers = set(self._timers)
        self._read()
        if self._happened is not None and self._happened != self._at[EventTime.STARTUP]:
            raise ConfigurationError(
                "an event of EventTime.STARTUP was changed after it had happened: change it before the environment is "
                "made, or make it one of EventTime.RESET"
            )
        for name in self._timers.keys() - timers:
            self._timers[name].draw(None)

    def _read(self) -> None:
        terms = terms_of(self._env.task.events, EventTerm)
        self._at = {time: [term for term in terms.values() if term.time is time] for time in EventTime}
        known = self._timers
        self._timers = {
            name: _Timer(name, term, self._env.step_dt, self._world)
            for name, term in terms.items()
            if term.time is EventTime.INTERVAL
        }
        for name in known.keys() & self._timers.keys():
            self._timers[name].left = known[name].left

    def startup(self) -> None:
        """Once, before the first episode."""
        self._happened = [replace(term) for term in self._at[EventTime.STARTUP]]
        for term in self._happened:
            term.function(self._env, self._all)

    def reset(self, env_ids: Tensor | None) -> None:
        """Run the events of an episode's beginning, in environments by index or mask."""
        for timer in self._timers.values():
            timer.draw(env_ids)
        self._run(env_ids, self._at[EventTime.RESET])

    def advance(self) -> None:
        """Run the events that are due at the beginning of a step."""
        for timer in self._timers.values():
            due = self._world.selector.where(timer.left == 0)
            if due is not None:
                self._run(due, [timer.term])
                timer.draw(due)
            timer.left -= 1

    def _run(self, env_ids: Tensor | None, terms: list[EventTerm]) -> None:
        """Run events of some environments, by index or mask, and undo what they did to the memory of others."""
        with self._kept_elsewhere(env_ids), self._world.selector.given(env_ids) as rows:
            for term in terms:
                term.function(self._env, rows)
            self._world.clock.touch()  # an event may have changed what a cached term depends on

    @contextmanager
    def _kept_elsewhere(self, env_ids: Tensor | None) -> Iterator[None]:
        """Put the task's own tensors back outside of a mask: events write them for all environments then."""
        if not is_mask(env_ids):
            yield
            return
        memory = [tensor for tensor in self._memory().values() if tensor.shape[:1] == env_ids.shape]
        before = [(tensor, tensor.clone(), tensor._version) for tensor in memory]
        yield
        others = ~env_ids
        for tensor, old, version in before:
            if tensor._version != version:
                write_rows(tensor, old, others)


class _Timer:
    """Counts each environment's steps to its next event."""

    def __init__(self, name: str, term: EventTerm, step_dt: float, world: World) -> None:
        least, most = term.interval
        if not 0.0 < least <= most:
            raise ConfigurationError(
                f"the interval of event '{name}' must be 0 < least <= most seconds, not {term.interval}"
            )
        self.term = term
        self._bounds = max(1, round(least / step_dt)), max(1, round(most / step_dt))
        self._random = world.random
        self.left = torch.zeros(world.num_envs, dtype=torch.int64, device=world.device)

    def draw(self, env_ids: Tensor | None) -> None:
        write_rows(self.left, self._random.integers(*self._bounds, env_ids), env_ids)
