"""Command manager: samples commands within ranges when an episode begins, and again in time."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from typing import TYPE_CHECKING

import torch
from torch import Tensor

from orbit_core.dynamics.indexing import write_rows
from orbit_core.envs.terms import CommandTerm, check_same_names, terms_of
from orbit_core.interfaces import ConfigurationError, ShapeError, UnknownNameError

if TYPE_CHECKING:
    from orbit_core.envs.environment import Environment


class CommandManager(Mapping[str, Tensor]):
    """Samples the commands of a task. ``env.commands["goal"]`` is the tensor (N, K) of that command, the same always.

    Args:
        env: whose task has the terms; its state has started.

    Raises:
        ConfigurationError: a range is empty or not finite, or a resampling time cannot be.
        ShapeError: a term's command has no row for each environment.
    """

    def __init__(self, env: Environment) -> None:
        self._env = env
        self.terms = terms_of(env.task.commands, CommandTerm)
        """Command terms by name."""
        self._commands = {name: _Command(name, term, env) for name, term in self.terms.items()}
        self.changing: list[_Command] = []
        """Commands that may change within an episode; the others cost a step nothing."""
        self._find_changing()

    def __getitem__(self, name: str) -> Tensor:
        if name not in self._commands:
            raise UnknownNameError("command", name, self._commands, f"task {type(self._env.task).__name__}")
        return self._commands[name].value

    def __setitem__(self, name: str, value: object) -> None:
        raise ConfigurationError(
            f"command '{name}' was replaced by another object, which a captured step would not see: write the tensor "
            f"in place, env.commands[{name!r}][:] = ..."
        )

    def __iter__(self) -> Iterator[str]:
        return iter(self._commands)

    def __len__(self) -> int:
        return len(self._commands)

    def memory(self) -> dict[str, Tensor]:
        """Tensors that commands remember from step to step, by name."""
        # The names of values are those that recordings have kept goals by.
        own = {name: command.value for name, command in self._commands.items()}
        return own | {f"{name} timer": command.left for name, command in self._commands.items()}

    def refresh(self) -> None:
        """Take the terms that the task has now: ranges and times hold from the next sample on.

        Raises:
            ConfigurationError: a range is empty, or there are other terms than before.
        """
        now = terms_of(self._env.task.commands, CommandTerm)
        check_same_names("command", self.terms, now, "leave it, and let no term read it")
        self.terms.update(now)
        for name, command in self._commands.items():
            command.read(self.terms[name])
        self._find_changing()

    def _find_changing(self) -> None:
        self.changing = [command for command in self._commands.values() if command.changes]

    def reset(self, env_ids: Tensor | None) -> None:
        """Sample every command for episodes that begin, by index, by mask, or in all environments if None."""
        for command in self._commands.values():
            command.sample(env_ids)
        if self._commands:
            self._env.world.clock.touch()  # terms that are cached may depend on a command

    def update(self) -> None:
        """Count the step, adjust commands that follow the world, and sample those whose time is over."""
        # A list, not a generator in `any`: every command has to be updated.
        changed = [command.update() for command in self.changing]
        if any(changed):
            self._env.world.clock.touch()


class _Command:
    """One command: its value, and the tensors that its next sample is drawn from."""

    def __init__(self, name: str, term: CommandTerm, env: Environment) -> None:
        self._name, self._env = name, env
        device = env.device
        low, high = _bounds(name, term, env)
        # A captured step reads the ranges from these tensors, so that a range changes without another capture.
        self._low, self._high = torch.tensor(low, device=device), torch.tensor(high, device=device)
        self.left = torch.zeros(env.num_envs, dtype=torch.int64, device=device)
        """(N,) steps to the next sample, counted where the term has a resampling time."""
        self.read(term)
        # The shape is found without a random number, so that streams begin as they would without commands.
        drawn = self._low.expand(env.num_envs, -1)
        value = term.command(env, drawn, env.all_ids)
        if not isinstance(value, Tensor) or value.shape[:1] != (env.num_envs,):
            shape = tuple(value.shape) if isinstance(value, Tensor) else type(value).__name__
            raise ShapeError(f"command '{name}' has shape {shape}, but needs a row for each of {env.num_envs} drawn")
        # A copy, for the term may have returned its argument, a view of the ranges.
        self.value = value.clone()

    def read(self, term: CommandTerm) -> None:
        """Take the ranges and the resampling time of a term."""
        self.term = term
        low, high = _bounds(self._name, term, self._env)
        self._low.copy_(torch.tensor(low))
        self._high.copy_(torch.tensor(high))
        self._steps = _steps(self._name, term, self._env.step_dt)

    @property
    def changes(self) -> bool:
        """True if the command may change within an episode."""
        kind = type(self.term)
        own = kind.expired is not CommandTerm.expired or kind.follow is not CommandTerm.follow
        return own or self._steps is not None

    def sample(self, env_ids: Tensor | None) -> None:
        """Draw another command in some environments."""
        with self._env.world.selector.given(env_ids) as rows:
            self._write(rows, env_ids)

    def update(self) -> bool:
        """Return True if the command may have changed."""
        env, due = self._env, self.term.expired(self._env)
        if self._steps is not None:
            # A time that was set while the environment runs finds zero here, and begins with a sample.
            self.left -= 1
            due = self.left <= 0 if due is None else due | (self.left <= 0)
        if due is not None:
            due = env.world.selector.where(due)
            if due is not None:
                self.sample(due)
        return self.term.follow(env, self.value) or due is not None

    def _write(self, env_ids: Tensor, rows: Tensor | None) -> None:
        """Draw for environments ``env_ids`` (n,), and write those that ``rows`` picks: them, a mask (N,) or all."""
        env = self._env
        drawn = env.world.random.uniform((len(self._low),), self._low, self._high, env_ids)
        value = self.term.command(env, drawn, env_ids)
        # Events and other commands have been drawn already: the order of draws is part of a seed's episode.
        write_rows(self.value, value, rows)
        if self._steps is not None:
            write_rows(self.left, env.world.random.integers(*self._steps, env_ids), rows)
        self.term.show(env, value, env_ids)


def _bounds(name: str, term: CommandTerm, env: Environment) -> tuple[list[float], list[float]]:
    """Least and most of each number that a command draws, checked."""
    ranges = term.ranges(env)
    for number, bounds in ranges.items():
        pair = isinstance(bounds, tuple | list) and len(bounds) == 2
        if not pair or not all(isinstance(each, int | float) and math.isfinite(each) for each in bounds):
            raise ConfigurationError(f"range '{number}' of command '{name}' must be two finite numbers, not {bounds!r}")
        if bounds[0] > bounds[1]:
            raise ConfigurationError(
                f"range '{number}' of command '{name}' is empty, for its least {bounds[0]:g} is above its most "
                f"{bounds[1]:g}: give (least, most)"
            )
    return [float(low) for low, _ in ranges.values()], [float(high) for _, high in ranges.values()]


def _steps(name: str, term: CommandTerm, step_dt: float) -> tuple[int, int] | None:
    """Fewest and most steps from one sample to the next; None where an episode has one."""
    if term.resampling_time is None:
        return None
    least, most = term.resampling_time
    if not 0.0 < least <= most < math.inf:
        raise ConfigurationError(
            f"the resampling time of command '{name}' must be 0 < least <= most seconds, not {term.resampling_time}"
        )
    return max(1, round(least / step_dt)), max(1, round(most / step_dt))
