"""The loop around libraries that leave it to others: collect and learn, report."""

from __future__ import annotations

import time
from abc import abstractmethod
from collections.abc import Callable
from pathlib import Path
from typing import Any

import torch
from torch.utils.tensorboard import SummaryWriter

from orbit_core.envs.environment import Environment
from orbit_core.envs.ppo import PpoSettings
from orbit_core.learning.episodes import EpisodeTally
from orbit_core.learning.trainer import Progress, Trainer


class LoopTrainer(Trainer):
    """A trainer whose library does one iteration at a time."""

    def __init__(self, environment: Environment, settings: PpoSettings, folder: Path, seed: int) -> None:
        super().__init__(environment, settings, folder, seed)
        torch.manual_seed(seed)
        self.tally = EpisodeTally(environment.device)
        """To be told of every step."""
        self.batch = environment.num_envs * settings.steps_per_iteration
        """Steps of all environments in an iteration."""
        self._iteration = 0

    @abstractmethod
    def iterate(self, iteration: int) -> None:
        """Collect ``settings.steps_per_iteration`` steps of every environment, and learn from them."""

    @abstractmethod
    def load(self, state: Any) -> None:
        """Take over what :meth:`state` gave."""

    def learn(self, iterations: int, report: Callable[[Progress], None]) -> None:
        begin, first, last = time.perf_counter(), self._iteration, self._iteration + iterations - 1
        with SummaryWriter(str(self.folder / "tensorboard")) as board:
            for iteration in range(first, last + 1):
                self.iterate(iteration)
                self._iteration = iteration + 1
                done = (iteration - first + 1) * self.batch
                progress = Progress(iteration, done, time.perf_counter() - begin, *self.tally.read())
                board.add_scalar("episode/return", progress.episode_return, iteration)
                board.add_scalar("episode/success_rate", progress.success_rate, iteration)
                report(progress)

    def restore(self, state: Any, iteration: int) -> None:
        self.load(state)
        self._iteration = iteration + 1
