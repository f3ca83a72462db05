"""The loop around libraries that leave it to others: collect and learn, report."""

from __future__ import annotations

import math
import time
from abc import abstractmethod
from collections.abc import Callable
from pathlib import Path
from typing import Any

import torch
from torch.utils.tensorboard import SummaryWriter

from orbit_core.envs.environment import Environment
from orbit_learn.ends import EpisodeTally
from orbit_learn.trainer import Progress, Settings, Trainer


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
