"""Measurements that are averages over the time since the last one."""

from __future__ import annotations

from abc import abstractmethod
from typing import Any

import torch
from torch import Tensor

from orbit_core.dynamics.indexing import take_rows, write_rows
from orbit_core.scene import SensorSpec
from orbit_core.sensors.context import SensorContext
from orbit_core.sensors.timed import TimedSensor


class AveragingSensor(TimedSensor):
    """Sums a quantity while the world steps; the window is the sensor's period, without a rate the world's step.

    A reset empties an environment's window, whose mean is then zero. A world that announces its steps with
    :meth:`begin_step` gets averages over them; otherwise each :meth:`advance` is its own window.
    """

    scheduled = (*TimedSensor.scheduled, "_window_over", "_announced")

    def __init__(self, spec: SensorSpec, context: SensorContext, shape: tuple[int, ...]) -> None:
        super().__init__(spec, context)
        self._sum = torch.zeros(self.num_envs, *shape, device=self.device)
        self._count = torch.zeros(self.num_envs, *(1 for _ in shape), device=self.device)
        self._window_over = False
        self._announced = False

    def begin_step(self) -> None:
        super().begin_step()
        self._announced = True
        if self.period is None:
            self._window_over = True

    def advance(self, steps: int) -> None:
        total = self._integrate(steps)
        if self._window_over:
            self._sum.copy_(total)
            self._count.fill_(steps)
        else:
            self._sum += total
            self._count += steps
        self._window_over = not self._announced if self.period is None else self._elapsed + steps >= self.period
        super().advance(steps)

    def _forget(self, env_ids: Tensor | None) -> None:
        super()._forget(env_ids)
        # Zero sums make the next chunk's replacement and its addition the same.
        write_rows(self._sum, 0.0, env_ids)
        write_rows(self._count, 0.0, env_ids)

    def save_state(self) -> dict[str, Any]:
        return super().save_state() | {"window": (self._sum.clone(), self._count.clone())}

    def load_state(self, state: dict[str, Any]) -> None:
        super().load_state(state)
        for own, saved in zip((self._sum, self._count), state["window"], strict=True):
            own.copy_(saved)

    @abstractmethod
    def _integrate(self, steps: int) -> Tensor:
        """(N, *shape) the quantity's mean over the last ``steps`` steps, times ``steps``."""

    def _mean(self, env_ids: Tensor | None) -> Tensor:
        """(n, *shape) over the window so far; zero in one that is empty."""
        return take_rows(self._sum / self._count.clamp_min(1.0), env_ids)
