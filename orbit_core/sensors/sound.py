"""Base of sensors of sound, so that videos and datasets find those of any package."""

from __future__ import annotations

from abc import abstractmethod

from torch import Tensor

from orbit_core.sensors.timed import TimedSensor


class SoundSensor(TimedSensor):
    """A sensor whose readings are waveforms: each holds the samples of its last period."""

    sampling_rate: int
    """Hz."""

    @property
    @abstractmethod
    def sound(self) -> Tensor:
        """Pressure (N, samples) in Pa over the last period, at :attr:`sampling_rate`."""

    @property
    def complete(self) -> bool:
        """True if the last period ended with the last physics step."""
        return self._elapsed == 0
