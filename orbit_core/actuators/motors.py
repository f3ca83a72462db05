"""Transmissions and windings of many motors at once: :mod:`orbit_core.scene.motors`, batched."""

from __future__ import annotations

import math
from collections.abc import Sequence

import torch
from torch import Tensor

from orbit_core.scene import Transmission, Windings

_DIRECT = Transmission(ratios=(1.0,))
_TINY = 1e-9
REFERENCE = 25.0
"""Degrees Celsius at which resistances are told, and of motors of which nothing is known."""


class Ratios:
    """Magnitudes of the ratios of k joints' transmissions; None has 1.

    A table of straight lines is its first value and a ramp for each line, so that nothing is looked up.
    """

    def __init__(self, transmissions: Sequence[Transmission | None], device: torch.device) -> None:
        tables = [transmission or _DIRECT for transmission in transmissions]
        most = max(len(table.positions) for table in tables) - 1
        starts, widths, slopes = (torch.zeros(len(tables), max(most, 1)) for _ in range(3))
        for row, table in enumerate(tables):
            positions, ratios = torch.tensor(table.positions), torch.tensor(table.ratios)
            lines = len(positions) - 1
            starts[row, :lines], widths[row, :lines] = positions[:-1], positions.diff()
            slopes[row, :lines] = ratios.diff() / positions.diff()
        self._starts, self._widths, self._slopes = (part.to(device) for part in (starts, widths, slopes))
        self._zeros = torch.zeros_like(self._widths)
        self._first = torch.tensor([table.ratios[0] for table in tables], device=device)

    def at(self, position: Tensor) -> Tensor:
        """(N, k) at positions (N, k) of the joints."""
        along = torch.clamp(position[..., None] - self._starts, self._zeros, self._widths)
        return (self._first + (self._slopes * along).sum(-1)).abs()


class WindingModel:
    """Temperatures of k motors in N environments; a motor without windings neither warms nor is limited."""

    def __init__(
        self, windings: Sequence[Windings | None], num_envs: int, physics_dt: float, device: torch.device
    ) -> None:
        cold = Windings(motor_constant=1.0, thermal_resistance=1.0, time_constant=1.0)
        told = [motor or cold for motor in windings]

        def row(values: Sequence[float]) -> Tensor:
            return torch.tensor(values, dtype=torch.float32, device=device)

        self._rise_per_effort = row(
            [0.0 if w is None else w.thermal_resistance / w.motor_constant**2 for w in windings]
        )  # K over the surroundings, at rest, of a squared effort
        self._growth = row([w.resistance_rise for w in told])
        self._share = row([-math.expm1(-physics_dt / w.time_constant) for w in told])
        self.ambient = row([w.ambient for w in told])
        """(k,) degrees Celsius of what surrounds the motors."""
        self._highest = row([w.highest for w in told])
        self._span = row([w.highest - w.derating_from for w in told])
        self.temperatures = self.ambient.repeat(num_envs, 1)
        """(N, k) degrees Celsius."""

    def derating(self) -> Tensor:
        """(N, k) part in [0, 1] of a motor's efforts that it may give."""
        return ((self._highest - self.temperatures) / self._span).clamp(0.0, 1.0)

    def warm(self, efforts: Tensor, ratios: Tensor | None) -> None:
        """Pass one physics step in which motors exert ``efforts`` (N, k) at their joints, through ``ratios`` (N, k)."""
        own = efforts if ratios is None else efforts / ratios.clamp_min(_TINY)
        resistance = 1.0 + self._growth * (self.temperatures - REFERENCE)
        target = self.ambient + self._rise_per_effort * own.square() * resistance
        self.temperatures += self._share * (target - self.temperatures)
