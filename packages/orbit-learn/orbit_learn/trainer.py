"""Interface of learning libraries to ``orbit train``, and the training loop of libraries without one."""

from __future__ import annotations

import contextlib
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
from orbit_learn.across import rows_of_engines
from orbit_learn.ends import EpisodeTally
from orbit_learn.networks import ActorNetwork
from orbit_learn.processes import meet, met, rank


@dataclass(frozen=True)
class Progress:
    """Progress of a training."""

    iteration: int
    """Number of the last iteration, from 0."""
    env_steps: int
    """Steps of all environments together; a trainer counts since it was made, a training since its first iteration."""
    seconds: float
    """Seconds of collecting and learning, counted the same way."""
    episode_return: float
    """Mean return of the last episodes; NaN before any has ended."""
    success_rate: float
    """Success rate of the last episodes; NaN before any has ended."""
    episodes: int = 0
    """Number of these episodes."""
    diverged: int = 0
    """Episodes so far in which the simulation diverged; a training resets them."""
    loss: float = math.nan
    """Mean loss of the iteration, if the algorithm has a single one; else NaN."""
    engines: Mapping[str, float] = field(default_factory=dict)
    """Success rate of the last episodes on each engine, by name; empty if there is only one."""
    metrics: Mapping[str, float] = field(default_factory=dict)
    """Means of the task's metrics over the last episodes, by name; empty if the library does not report them."""


def half_cosine(initial: float, progress: float) -> float:
    """Return the learning rate that falls along half a cosine (Loshchilov and Hutter, SGDR, 2017).

    Args:
        initial: rate at the begin.
        progress: share of the training that is over; zero is reached at 1.
    """
    return initial * 0.5 * (1.0 + math.cos(math.pi * min(1.0, progress)))


def set_half_cosine(optimizer: torch.optim.Optimizer, initial: float, progress: float) -> None:
    """Set an optimiser's learning rate to :func:`half_cosine`.

    Args:
        optimizer: whose rate is set.
        initial: rate at the begin.
        progress: share of the training that is over.
    """
    for group in optimizer.param_groups:
        group["lr"] = half_cosine(initial, progress)


class LearningSettings(Protocol):
    """Settings that every algorithm has; they are frozen dataclasses."""

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
    """Trainer of one policy in one environment with one library.

    Args:
        environment: environment that only this trainer steps.
        settings: settings of the algorithm.
        folder: folder for TensorBoard's files.
        seed: seed of exploration and of the networks' weights.

    Raises:
        ConfigurationError: the library does not support a setting.
    """

    name: ClassVar[str]
    """Name of the library as the user types it."""
    several_gpus: ClassVar[bool] = False
    """True if processes of torchrun, one for each GPU or part of the CPU, learn one policy together."""
    several_engines: ClassVar[bool] = False
    """True if the trainer also takes :class:`~orbit_learn.across.AcrossEngines` as its environment."""
    imitates: ClassVar[bool] = False
    """Whether the trainer can first imitate the task's expert, :attr:`PpoSettings.imitation_steps`."""
    begins_with_policies: ClassVar[bool] = False
    """Whether the actor can begin with a policy, :attr:`PpoSettings.start`, and the critic learn alone at first."""
    chooses_arithmetic: ClassVar[bool] = False
    """True for a trainer that takes :attr:`PpoSettings.precision` and :attr:`PpoSettings.compile_update`."""
    settings_type: ClassVar[type[Any]] = PpoSettings
    """Class of the algorithm's settings."""
    options: ClassVar[tuple[str, ...]] = ("ppo",)
    """Options of ``orbit train`` for the settings: first the one of ``key=value``, then those of single fields."""

    def __init__(self, environment: Environment, settings: Settings, folder: Path | str, seed: int) -> None:
        # Settings are shared by libraries, so that one which lacks a feature must say so, and not ignore it.
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
        for setting, only in (("precision", "float32"), ("compile_update", False)):
            if not self.chooses_arithmetic and (value := getattr(settings, setting, only)) != only:
                raise ConfigurationError(
                    f"library '{self.name}' has no {setting}={value}: use --library orbit --algorithm ppo, or leave "
                    f"--ppo {setting} out"
                )
        self.environment = environment
        self.settings = settings
        self.folder = as_path(folder)
        self.seed = seed

    def close(self) -> None:
        """Release what would keep the processes of a training from parting; the trainer is not used afterwards."""

    @abstractmethod
    def learn(self, iterations: int, report: Callable[[Progress], None]) -> None:
        """Collect and learn.

        Args:
            iterations: number of iterations.
            report: called after each iteration; :meth:`state` and :meth:`actor` are then those of its end.
        """

    @abstractmethod
    def state(self) -> Any:
        """Return the state to continue learning from, as :func:`~orbit_learn.training.write_checkpoint` writes it."""

    @abstractmethod
    def restore(self, state: Any, iteration: int) -> None:
        """Continue from the state at the end of an iteration."""

    @abstractmethod
    def actor(self) -> ActorNetwork:
        """Return a copy of the policy on the CPU, with its normalisation and without exploration."""


# Libraries that run their own loop report progress by themselves, and derive from `Trainer`.
class LoopTrainer(Trainer[Settings]):
    """Trainer whose library does one iteration at a time."""

    def __init__(self, environment: Environment, settings: Settings, folder: Path | str, seed: int) -> None:
        super().__init__(environment, settings, folder, seed)
        if self.several_gpus:
            meet(environment.device)
        # Before the networks are made: their first weights come from torch's own generator.
        torch.manual_seed(seed)
        self.tally = EpisodeTally(environment.device, rows_of_engines(environment))
        """Tally of episodes; :meth:`iterate` must add every step."""
        self.batch = environment.num_envs * settings.steps_per_iteration * met()
        """Steps of all environments, of all processes, in an iteration."""
        self.steps_ahead = 0
        """Steps of all environments that were collected in addition to those of the iterations."""
        self._iteration = 0

    @abstractmethod
    def iterate(self, iteration: int) -> None:
        """Collect ``settings.steps_per_iteration`` steps of every environment, and learn from them."""

    def loss(self) -> float:
        """Return the mean loss of the last iteration, if the algorithm has a single one; else NaN."""
        return math.nan

    def numbers(self) -> Mapping[str, float]:
        """Return further numbers of the last iteration for TensorBoard, by name."""
        return {}

    @abstractmethod
    def load(self, state: Any) -> None:
        """Restore the result of :meth:`state`."""

    def learn(self, iterations: int, report: Callable[[Progress], None]) -> None:
        begin, first, last = time.perf_counter(), self._iteration, self._iteration + iterations - 1
        # One of several processes writes.
        with _board(self.folder / "tensorboard") if rank() == 0 else contextlib.nullcontext() as board:
            for iteration in range(first, last + 1):
                self.iterate(iteration)
                self._iteration = iteration + 1
                # Counted since this call, because a resumed training adds the steps of earlier ones.
                done = (iteration - first + 1) * self.batch + self.steps_ahead
                returns, success_rate, episodes = self.tally.read()
                seconds = time.perf_counter() - begin
                measured = {"loss": self.loss(), "metrics": self.tally.metrics, "engines": dict(self.tally.parts)}
                progress = Progress(iteration, done, seconds, returns, success_rate, episodes, **measured)
                if board is not None:
                    board.add_scalar("episode/return", progress.episode_return, iteration)
                    board.add_scalar("episode/success_rate", progress.success_rate, iteration)
                    for name, value in progress.engines.items():
                        board.add_scalar(f"episode/success_rate_{name}", value, iteration)
                    for name, value in self.numbers().items():
                        board.add_scalar(f"learning/{name}", value, iteration)
                    # An algorithm without a single loss has no curve to draw.
                    if not math.isnan(progress.loss):
                        board.add_scalar("loss", progress.loss, iteration)
                report(progress)

    def restore(self, state: Any, iteration: int) -> None:
        self.load(state)
        self._iteration = iteration + 1


def _board(folder: Path) -> contextlib.AbstractContextManager[Any]:
    """Return a writer for TensorBoard; None in its place where it is not installed: ``curve.jsonl`` has the curve."""
    try:
        from torch.utils.tensorboard import SummaryWriter
    except ImportError:
        return contextlib.nullcontext()
    return SummaryWriter(str(folder))
