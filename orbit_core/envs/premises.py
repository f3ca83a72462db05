"""Premises: conditions of an episode's start, checked in starts that are sampled at build, and at each start."""

from __future__ import annotations

import math
import warnings
from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING

import torch
from torch import Tensor

from orbit_core.dynamics.arguments import MOST_STEPS
from orbit_core.dynamics.indexing import take_rows, write_rows
from orbit_core.envs.task import Task
from orbit_core.envs.terms import PremiseTerm, check_same_names, per_environment, terms_of
from orbit_core.interfaces import ConfigurationError, PremiseError

if TYPE_CHECKING:
    from orbit_core.envs.environment import Environment

# Starts in which premises are checked at build, if there are not as many environments.
LEAST_STARTS = 8
# Before a premise's name, the name of its metric: 1 where it held when the episode began, else 0.
METRIC = "premise_"


@dataclass(frozen=True)
class PremiseCheck:
    """Result of a premise in the starts that were sampled at build."""

    name: str
    """Name of the premise in the task."""
    reason: str
    """What a start is in which it does not hold, as the task says it."""
    starts: int
    """Number of starts that were sampled."""
    failed: int
    """Number of those in which it did not hold."""


class PremiseManager:
    """Settles environments whose episode begins, and checks the task's premises in them.

    Args:
        env: whose task has the premises.
        simulated: whether time may pass in the world ahead of an episode: recorded states and real robots do not wait.

    Raises:
        ConfigurationError: a time that cannot be.
        TypeError: the premises hold something else than terms.
    """

    def __init__(self, env: Environment, simulated: bool) -> None:
        world, task = env.world, env.task
        self._env, self._world, self._task = env, world, task
        self.terms = terms_of(task.premises, PremiseTerm)
        """Premise terms by name."""
        steps = _steps(task, "settle_time"), _steps(task, "premise_time")
        self.settle_steps, self._sampled_steps = steps if simulated else (0, 0)
        """Physics steps that pass before an episode's first observation."""
        self._simulated = simulated
        self.held = torch.ones(len(self.terms), world.num_envs, dtype=torch.bool, device=world.device)
        """(P, N) which premises held when each environment's episode began."""
        self.checks: tuple[PremiseCheck, ...] = ()
        """What the starts sampled at build were like; empty without premises."""

    def refresh(self) -> None:
        """Take the terms that the task has now.

        Raises:
            ConfigurationError: there are other terms than before.
        """
        now = terms_of(self._task.premises, PremiseTerm)
        check_same_names("premise", self.terms, now, "give it a function that returns True")
        # In place, because metrics are named by this dictionary's order.
        self.terms.update(now)

    def begin(self, env_ids: Tensor | None) -> None:
        """After the events of a reset: let time pass, then note which premises hold.

        Args:
            env_ids: environments by index, or all if None; by mask in a traced step, where nothing settles.
        """
        if self.settle_steps:
            self._world.settle(self.settle_steps, env_ids)
        for number, value in enumerate(self._values()):
            write_rows(self.held[number], take_rows(value, env_ids), env_ids)

    def metrics(self) -> dict[str, Tensor]:
        """(N,) 1 where a premise held when the episode began, else 0, by the metric's name."""
        return {f"{METRIC}{name}": self.held[number].float() for number, name in enumerate(self.terms)}

    def sample(self, begin: Callable[[None], None]) -> None:
        """Begin some episodes, simulate them for ``premise_time``, and say which premises do not hold then.

        The environments' random streams go on as if nothing had been drawn.

        Args:
            begin: begins episodes in all environments.

        Raises:
            PremiseError: a premise holds in none of the starts.
        """
        if not (self.terms and self._simulated):
            return
        world = self._world
        # Checked starts must not shift the random numbers of the first episodes: seeds give the same runs with premises
        # and without.
        streams = world.random.save_state()
        # One environment alone says little of how often a premise fails, so that it begins several times.
        rounds = math.ceil(LEAST_STARTS / world.num_envs)
        failed = torch.zeros(len(self.terms), dtype=torch.int64, device=world.device)
        for _ in range(rounds):
            begin(None)
            if (left := self._sampled_steps - self.settle_steps) > 0:
                world.settle(left)
            failed += torch.stack([~value for value in self._values()]).sum(1)
        world.random.load_state(streams)
        starts = rounds * world.num_envs
        self.checks = tuple(
            PremiseCheck(name, term.reason, starts, count)
            for (name, term), count in zip(self.terms.items(), failed.tolist(), strict=True)
        )
        self._report()

    def _report(self) -> None:
        for check in self.checks:
            if check.failed == check.starts:
                raise PremiseError(
                    f"{self._who(check)} holds in none of {check.starts} starts: {check.reason}. {self._remedy(check)}"
                )
            if check.failed:
                share = f"fails in {check.failed} of {check.starts} starts"
                text = f"{self._who(check)} {share}: {check.reason}. {self._remedy(check)}"
                warnings.warn(text, RuntimeWarning, stacklevel=6)

    def _who(self, check: PremiseCheck) -> str:
        return f"on backend '{self._world.backend}', premise '{check.name}' of task {type(self._task).__name__}"

    def _remedy(self, check: PremiseCheck) -> str:
        return (
            "Change the task's reset events, give it settle_time, or give this backend other settings; "
            f"premises.{check.name}=None goes without it"
        )

    def _values(self) -> list[Tensor]:
        return [self._value(name, term) for name, term in self.terms.items()]

    def _value(self, name: str, term: PremiseTerm) -> Tensor:
        what = f"premise '{name}'"
        value = per_environment(term.function(self._env), what, self._world.num_envs)
        if value.dtype != torch.bool:
            raise ConfigurationError(f"{what} gives {value.dtype}: its function must give torch.bool")
        return value


def _steps(task: Task, name: str) -> int:
    """Physics steps of one of the task's times."""
    seconds = getattr(task, name)
    if not 0.0 <= seconds <= MOST_STEPS * task.physics_dt:
        raise ConfigurationError(f"{name} must be zero seconds or more, not {seconds:g}")
    # Less a millionth, because 0.1 s in steps of 5 ms are 20 steps and not 21 by rounding.
    return math.ceil(seconds / task.physics_dt - 1e-6)
