"""Interface of learning libraries to ``orbit train``, and the training loop of libraries without one."""

from __future__ import annotations

import math
import time
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, ClassVar, Generic, Protocol, TypeVar

import torch

from orbit_core.envs.environment import Environment
from orbit_core.envs.ppo import PpoSettings
from orbit_core.files import as_path
from orbit_core.interfaces import ConfigurationError
from orbit_learn.ends import EpisodeTally
from orbit_learn.networks import ActorNetwork


@dataclass(frozen=True)
class Progress:
    """How far a training has come."""

    iteration: int
    """The one just done, from 0."""
    env_steps: int
    """Steps of all environments together; a trainer counts since it was made, a training since its first iteration."""
    seconds: float
    """Seconds of collecting and learning, counted likewise."""
    episode_return: float
    """Mean over the last episodes; NaN before any has ended."""
    success_rate: float
    """Success rate of the last episodes; NaN before any has ended."""
    episodes: int = 0
    """How many these are."""
    diverged: int = 0
    """Episodes so far in which the simulation diverged; a training resets them."""
    loss: float = math.nan
    """Mean of what the iteration has brought down, where that is one number; else NaN."""
    metrics: Mapping[str, float] = field(default_factory=dict)
    """Means over the last episodes of what the task measures, by name; empty where the library does not tell."""


class LearningSettings(Protocol):
    """What the settings of every algorithm hold; they are frozen dataclasses."""

    @property
    def iterations(self) -> int:
        """Number of iterations, each of collecting steps and learning from them."""
        ...

    @property
    def steps_per_iteration(self) -> int:
        """Environment steps that every environment contributes to an iteration."""
        ...


Settings = TypeVar("Settings", bound=LearningSettings)


class Trainer(ABC, Generic[Settings]):
    """Trains one policy in one environment with one library.

    Args:
        environment: stepped by this trainer alone.
        settings: of the algorithm.
        folder: takes TensorBoard's files.
        seed: of exploration and of the networks' weights.

    Raises:
        ConfigurationError: the settings ask for what the library does not do.
    """

    name: ClassVar[str]
    """The library's name as the user types it."""
    several_gpus: ClassVar[bool] = False
    """Whether processes that torchrun starts, one a GPU, learn one policy together."""
    imitates: ClassVar[bool] = False
    """Whether it imitates the task's expert first, :attr:`PpoSettings.imitation_steps`."""
    begins_with_policies: ClassVar[bool] = False
    """Whether its actor can begin with a policy, :attr:`PpoSettings.start`, and its critic learn alone at first."""
    settings_type: ClassVar[type[Any]] = PpoSettings
    """Class of its algorithm's settings."""

    def __init__(self, environment: Environment, settings: Settings, folder: Path | str, seed: int) -> None:
        if getattr(settings, "imitation_steps", 0) and not self.imitates:
            raise ConfigurationError(
                f"library '{self.name}' imitates no expert before it learns: use --library rsl-rl, or "
                "--ppo imitation_steps=0"
            )
        if getattr(settings, "start", "") and not self.begins_with_policies:
            raise ConfigurationError(
                f"library '{self.name}' begins with no policy: use --library rsl-rl, or leave --ppo start out"
            )
        if getattr(settings, "critic_first", 0) and not self.begins_with_policies:
            raise ConfigurationError(
                f"library '{self.name}' lets no critic learn alone: use --library rsl-rl, or --ppo critic_first=0"
            )
        self.environment = environment
        self.settings = settings
        self.folder = as_path(folder)
        self.seed = seed

    @abstractmethod
    def learn(self, iterations: int, report: Callable[[Progress], None]) -> None:
        """Collect and learn; tells after each iteration, and :meth:`state` and :meth:`actor` are then of its end."""

    @abstractmethod
    def state(self) -> Any:
        """Return all that learning goes on with, as :func:`~orbit_learn.training.write_checkpoint` writes it."""

    @abstractmethod
    def restore(self, state: Any, iteration: int) -> None:
        """Go on from the state at the end of an iteration."""

    @abstractmethod
    def actor(self) -> ActorNetwork:
        """Return a copy of the policy on the CPU, without exploration, normalisation included."""


class LoopTrainer(Trainer[Settings]):
    """A trainer whose library does one iteration at a time."""

    def __init__(self, environment: Environment, settings: Settings, folder: Path | str, seed: int) -> None:
        super().__init__(environment, settings, folder, seed)
        torch.manual_seed(seed)
        self.tally = EpisodeTally(environment.device)
        """Counts episodes; it is to be told of every step."""
        self.batch = environment.num_envs * settings.steps_per_iteration
        """Steps of all environments in an iteration."""
        self.steps_ahead = 0
        """Steps of all environments that were collected beside those of the iterations."""
        self._iteration = 0

    @abstractmethod
    def iterate(self, iteration: int) -> None:
        """Collect ``settings.steps_per_iteration`` steps of every environment, and learn from them."""

    def loss(self) -> float:
        """What the last iteration has brought down, where that is one number; else NaN."""
        return math.nan

    @abstractmethod
    def load(self, state: Any) -> None:
        """Take over what :meth:`state` gave."""

    def learn(self, iterations: int, report: Callable[[Progress], None]) -> None:
        from torch.utils.tensorboard import SummaryWriter  # late: only trainers without a loop of their own need it

        begin, first, last = time.perf_counter(), self._iteration, self._iteration + iterations - 1
        with SummaryWriter(str(self.folder / "tensorboard")) as board:
            for iteration in range(first, last + 1):
                self.iterate(iteration)
                self._iteration = iteration + 1
                done = (iteration - first + 1) * self.batch + self.steps_ahead
                returns, success_rate, episodes = self.tally.read()
                seconds = time.perf_counter() - begin
                told = {"loss": self.loss(), "metrics": self.tally.metrics}
                progress = Progress(iteration, done, seconds, returns, success_rate, episodes, **told)
                board.add_scalar("episode/return", progress.episode_return, iteration)
                board.add_scalar("episode/success_rate", progress.success_rate, iteration)
                if not math.isnan(progress.loss):
                    board.add_scalar("loss", progress.loss, iteration)
                report(progress)

    def restore(self, state: Any, iteration: int) -> None:
        self.load(state)
        self._iteration = iteration + 1
