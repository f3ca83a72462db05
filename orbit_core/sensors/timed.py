"""The timer, delay, noise and held value that all sensors share."""

from __future__ import annotations

import math
from abc import abstractmethod
from collections.abc import Hashable
from typing import Any, ClassVar

import torch
from torch import Tensor

from orbit_core.dynamics.indexing import is_mask, take_rows, write_rows
from orbit_core.interfaces import ConfigurationError, Sensor
from orbit_core.scene import SensorSpec
from orbit_core.sensors.context import SensorContext
from orbit_core.sensors.memory import Memory, with_rows

Values = dict[str, Tensor]
"""One measurement of some environments: each tensor (n, ...)."""

_RATE_TOLERANCE = 1e-4  # time steps such as 1/120 s are written with few digits


class TimedSensor(Sensor):
    """Measures at its rate, holds back by its delay, adds its noise, and keeps the value in between.

    A sensor without a rate measures at the first read after the world has stepped, and costs nothing unread. A sensor
    with a rate measures when it is due, read or not, for the state will be gone later. Its due times are multiples of
    its period on the world's clock, which a reset leaves running. A reset environment's next reading is fresh (that of
    the first read, or of the next step's start), and stands for all of its delayed past. Writing state without a step
    or reset leaves the held value.

    A subclass implements :meth:`_measure` and names in ``noisy`` the values that noise is added to.
    """

    noisy: ClassVar[tuple[str, ...]] = ()
    scheduled: ClassVar[tuple[str, ...]] = ("_elapsed", "_outdated", "_empty", "_some_wait")
    """Attributes of plain Python that decide what the sensor does in the next step; subclasses add theirs."""
    costly: ClassVar[bool] = False
    """Whether environments that were reset should be measured alone, for a measurement costs more than to find them."""

    def __init__(self, spec: SensorSpec, context: SensorContext) -> None:
        """Check the timing.

        Raises:
            ConfigurationError: the rate does not divide the physics rate, or the delay is no multiple of the period.
        """
        self.spec = spec
        self.engine = context.engine
        self.num_envs = context.engine.num_envs
        self.device = context.engine.device
        self.physics_dt = context.physics_dt
        self.period = period_in_steps(spec, context.physics_dt)
        """Physics steps between measurements; None measures whenever the world steps."""
        self._random = context.random
        self._selector = context.random.selector
        self._delay = _delay_in_periods(spec)
        self._lazy = self.period is None or (self.period == 1 and self._delay == 0)
        self._fleeting = self._lazy and not self._noisy and not self.costly
        """Whether the sensor's value is a function of the present state alone, and is measured anew when in doubt."""
        self._measured = False
        """True while the value of a fleeting sensor is that of the present state."""
        self._elapsed = 0
        self._outdated = True
        self._empty = True
        """Whether nothing was measured yet, or since all environments were reset."""
        self._some_wait = False
        self._waiting = torch.zeros(self.num_envs, dtype=torch.bool, device=self.device)
        """(N,) environments that were reset and not measured since."""
        self._present: Values = {}
        """Values of a fleeting sensor at the present state."""
        self._held = Memory()
        """Last measurements (1 + delay, N, ...) of all other sensors, the newest first."""
        self._bias = Memory()

    # The world's side ------------------------------------------------------------------------------------------------

    def begin_step(self) -> None:
        if not self._lazy:
            self._settle()

    def advance(self, steps: int) -> None:
        if self.period is not None:
            self._elapsed += steps
            if self._elapsed < self.period:
                return
            self._elapsed %= self.period
        if self._fleeting:
            self._measured = False
        elif self._lazy:
            self._outdated = True
        else:
            self._update()

    def reset(self, env_ids: Tensor | None = None) -> None:
        self._forget(self._selector.resolve(env_ids))

    def _forget(self, env_ids: Tensor | None) -> None:
        """Drop what is remembered of some environments: indices, or a mask in a traced step."""
        if self._fleeting:
            self._measured = False
        elif env_ids is None:
            self._empty, self._some_wait = True, False
            self._waiting.zero_()
        else:
            write_rows(self._waiting, True, env_ids)
            self._some_wait = True
        for name, bias in self._bias.items():
            self._bias[name] = with_rows(bias, self._draw_bias(bias.shape[1:], env_ids), env_ids)

    def save_state(self) -> dict[str, Any]:
        """Everything that later readings depend on besides the engine's state."""
        return {
            "counters": self.counters,
            "waiting": self._waiting.clone(),
            "held": self._held.saved(),
            "bias": self._bias.saved(),
        }

    def load_state(self, state: dict[str, Any]) -> None:
        """Return to a saved state."""
        self.counters = state["counters"]
        self._waiting.copy_(state["waiting"])
        self._held.load(state["held"])
        self._bias.load(state["bias"])

    @property
    def counters(self) -> tuple[Hashable, ...]:
        """Values of :attr:`scheduled`. Setting them drops what was measured of the present state."""
        return tuple(getattr(self, name) for name in self.scheduled)

    @counters.setter
    def counters(self, values: tuple[Any, ...]) -> None:
        for name, value in zip(self.scheduled, values, strict=True):
            setattr(self, name, value)
        self._measured = False

    # The subclass's side ---------------------------------------------------------------------------------------------

    @abstractmethod
    def _measure(self, env_ids: Tensor | None) -> Values:
        """Measure some environments now, without noise; the tensors are the sensor's to keep.

        With a mask (N,) bool they are of all environments, and rows outside of it count for nothing.
        """

    def _read(self, name: str) -> Tensor:
        """The held value (N, ...) of that name."""
        self._settle()
        return self._present[name] if self._fleeting else self._held[name][-1]

    def _noise(self, name: str, shape: tuple[int, ...], env_ids: Tensor | None) -> Tensor:
        """A draw (n, *shape) of white noise plus the value's bias."""
        if name not in self._bias:
            self._bias[name] = self._draw_bias(shape, None)
        rows = None if is_mask(env_ids) else env_ids  # a mask is set, and means itself
        return take_rows(self._bias[name], env_ids) + self._random.normal(shape, self.spec.noise.std, rows)

    def _corrupt(self, values: Values, env_ids: Tensor | None) -> None:
        """Add noise to a measurement, in place."""
        for name in self.noisy:
            value = values[name]
            values[name] = value + self._noise(name, tuple(value.shape[1:]), env_ids)

    # Own -------------------------------------------------------------------------------------------------------------

    def _draw_bias(self, shape: tuple[int, ...], env_ids: Tensor | None) -> Tensor:
        return self._random.normal(tuple(shape), self.spec.noise.bias_std, env_ids)

    def _sample(self, env_ids: Tensor | None) -> Values:
        values = self._measure(env_ids)
        if self._noisy:
            self._corrupt(values, env_ids)
        return values

    @property
    def _noisy(self) -> bool:
        return bool(self.spec.noise.std or self.spec.noise.bias_std)

    def _settle(self) -> None:
        if self._fleeting:
            if not self._measured:
                self._present = self._measure(None)
                self._measured = True
        elif self._outdated or self._empty:
            self._update()
        elif self._some_wait:
            self._renew()

    def _update(self) -> None:
        """Measure all environments."""
        for name, value in self._sample(None).items():
            newest = value[None]
            if self._empty or not self._delay:
                self._held[name] = (
                    newest if not self._delay else newest.repeat(1 + self._delay, *(1 for _ in value.shape))
                )
                continue
            history = torch.cat((newest, self._held[name][:-1]))
            self._held[name] = with_rows(history, newest, self._waiting, 1) if self._some_wait else history
        self._outdated = self._empty = False
        self._all_are_measured()

    def _renew(self) -> None:
        """Measure the environments that wait."""
        rows = self._selector.where(self._waiting)
        if rows is not None:
            with self._selector.only(rows if is_mask(rows) else None):
                values = self._sample(rows)
            for name, value in values.items():
                self._held[name] = with_rows(self._held[name], value[None], rows, 1)
        self._all_are_measured()

    def _all_are_measured(self) -> None:
        if self._some_wait:
            self._waiting.zero_()
            self._some_wait = False


def period_in_steps(spec: SensorSpec, physics_dt: float) -> int | None:
    """Physics steps between two measurements; None without a rate.

    Raises:
        ConfigurationError: the rate does not divide the physics rate.
    """
    if spec.rate is None:
        return None
    physics_rate = 1.0 / physics_dt
    if spec.rate <= 0.0:
        raise ConfigurationError(f"sensor '{spec.name}' has a rate of {spec.rate:g} Hz: give a positive one")
    ratio = physics_rate / spec.rate
    steps = round(ratio)
    if steps < 1 or abs(ratio - steps) > _RATE_TOLERANCE * ratio:
        near = sorted({physics_rate / max(math.floor(ratio), 1), physics_rate / max(math.ceil(ratio), 1)})
        raise ConfigurationError(
            f"sensor '{spec.name}' at {spec.rate:g} Hz does not divide the physics rate of {physics_rate:g} Hz: "
            f"take {' or '.join(f'{rate:g}' for rate in near)} Hz"
        )
    return steps


_MOST_PERIODS = 10_000
"""Longest delay in periods of a sensor, for each of which a value is kept."""


def _delay_in_periods(spec: SensorSpec) -> int:
    if spec.delay == 0.0:
        return 0
    if spec.rate is None:
        raise ConfigurationError(f"sensor '{spec.name}' has a delay but no rate: give it a rate to delay by")
    if not 0.0 <= spec.delay * spec.rate <= _MOST_PERIODS:
        raise ConfigurationError(
            f"sensor '{spec.name}' has a delay of {spec.delay:g} s, which must be from 0 to "
            f"{_MOST_PERIODS / spec.rate:g} s, {_MOST_PERIODS} of its periods, whose values are kept"
        )
    periods = round(spec.delay * spec.rate)
    if abs(spec.delay * spec.rate - periods) > _RATE_TOLERANCE * max(periods, 1):
        raise ConfigurationError(
            f"sensor '{spec.name}' has a delay of {spec.delay:g} s, which must be a multiple of its period "
            f"of {1.0 / spec.rate:g} s"
        )
    return periods
