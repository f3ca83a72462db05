"""A timed measurement that holds its value between updates."""

from __future__ import annotations

from abc import ABC, abstractmethod

from torch import Tensor

from orbit_core.scene import SensorSpec


class Sensor(ABC):
    """One sensor of all environments. A subclass adds typed properties for its values."""

    spec: SensorSpec

    def begin_step(self) -> None:
        """The world is about to step: what is averaged over a control step starts here."""

    @abstractmethod
    def advance(self, steps: int) -> None:
        """Tell the sensor that ``steps`` physics steps have passed; it measures when its period is over."""

    @abstractmethod
    def reset(self, env_ids: Tensor | None = None) -> None:
        """Forget the past of some environments; their next reading is fresh."""
