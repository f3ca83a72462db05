"""The timer, delay, noise and held value that all sensors share."""

from __future__ import annotations

import math
from abc import abstractmethod
from collections import deque
from typing import Any, ClassVar

import torch
from torch import Tensor

from orbit_core.dynamics.indexing import is_mask, write_rows
from orbit_core.interfaces import ConfigurationError, Sensor
from orbit_core.scene import SensorSpec
from orbit_core.sensors.context import SensorContext

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

    Held tensors are never changed in place. A subclass implements :meth:`_measure` and names in ``noisy`` the values
    that noise is added to.
    """

    noisy: ClassVar[tuple[str, ...]] = ()
    sums_in_place: ClassVar[bool] = False
    """Whether all that the sensor remembers, besides what it measured last, stays in the same memory."""

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
        self._history: deque[Values] = deque(maxlen=1 + _delay_in_periods(spec))
        self._lazy = self.period is None or (self.period == 1 and self._history.maxlen == 1)
        self._elapsed = 0
        self._outdated = False
        self._waiting: Tensor | None = None  # (N,) environments that were reset and not measured since
        self._masked = False
        self._bias: Values = {}

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
        if self._lazy:
            self._outdated = True
        else:
            self._update()

    def reset(self, env_ids: Tensor | None = None) -> None:
        self._forget(self._random.masking.rows(env_ids))

    def _forget(self, env_ids: Tensor | None) -> None:
        """Drop what is remembered of some environments: indices, or a mask in a traced step."""
        if env_ids is None:
            self._history.clear()
            self._waiting = None
        else:
            waiting = torch.zeros(self.num_envs, dtype=torch.bool, device=self.device)
            write_rows(waiting, True, env_ids)
            self._waiting = waiting if self._waiting is None else self._waiting | waiting
            self._masked = is_mask(env_ids)
        for name, bias in self._bias.items():
            self._bias[name] = _replace(bias, env_ids, self._draw_bias(bias.shape[1:], env_ids))

    def save_state(self) -> dict[str, Any]:
        """Everything that later readings depend on besides the engine's state."""
        return {
            "elapsed": self._elapsed,
            "outdated": self._outdated,
            "waiting": self._waiting,
            "history": tuple(self._history),
            "bias": dict(self._bias),
        }

    def load_state(self, state: dict[str, Any]) -> None:
        """Return to a saved state."""
        self._elapsed = state["elapsed"]
        self._outdated = state["outdated"]
        self._waiting = state["waiting"]
        self._history = deque(state["history"], maxlen=self._history.maxlen)
        self._bias = dict(state["bias"])

    # In a step that is traced once, and repeated without Python ------------------------------------------------------

    @property
    def untraceable(self) -> str:
        """What Python has to do anew for the sensor at each step; empty if nothing.

        A sensor that measures when the state changes, and keeps what it sums up in place, needs none.
        """
        return "keeps its own time" if not (self.sums_in_place and self._lazy) else "draws noise" if self._noisy else ""

    def repeated(self) -> None:
        """A step was repeated without Python: what is held is of the step before."""
        self._outdated = True
        self._waiting = None

    # The subclass's side ---------------------------------------------------------------------------------------------

    @abstractmethod
    def _measure(self, env_ids: Tensor | None) -> Values:
        """Measure some environments now, without noise; the tensors are the sensor's to keep."""

    def _read(self, name: str) -> Tensor:
        """The held value (N, ...) of that name."""
        self._settle()
        return self._history[0][name]

    def _noise(self, name: str, shape: tuple[int, ...], env_ids: Tensor | None) -> Tensor:
        """A draw (n, *shape) of white noise plus the value's bias."""
        if name not in self._bias:
            self._bias[name] = self._draw_bias(shape, None)
        bias = self._bias[name] if env_ids is None else self._bias[name][env_ids]
        return bias + self._random.normal(shape, self.spec.noise.std, env_ids)

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
        if self._outdated or not self._history or (self._masked and self._waiting is not None):
            self._update()  # for all, where to count those that wait is to look at a mask
        elif self._waiting is not None:
            ids = self._waiting.nonzero().squeeze(-1)
            self._overwrite(ids, self._sample(ids))

    def _update(self) -> None:
        values = self._sample(None)
        waiting = self._waiting
        self._history.append(values)
        while len(self._history) < (self._history.maxlen or 1):
            self._history.append(values)
        if waiting is not None and len(self._history) > 1:
            ids = waiting.nonzero().squeeze(-1)
            self._overwrite(ids, {name: value[ids] for name, value in values.items()})
        self._outdated = False
        self._waiting = None
        self._masked = False

    def _overwrite(self, env_ids: Tensor, values: Values) -> None:
        for index, held in enumerate(self._history):
            self._history[index] = {name: held[name].index_copy(0, env_ids, values[name]) for name in held}
        self._waiting = None


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


def _delay_in_periods(spec: SensorSpec) -> int:
    if spec.delay == 0.0:
        return 0
    if spec.rate is None:
        raise ConfigurationError(f"sensor '{spec.name}' has a delay but no rate: give it a rate to delay by")
    periods = round(spec.delay * spec.rate)
    if periods < 0 or abs(spec.delay * spec.rate - periods) > _RATE_TOLERANCE * max(periods, 1):
        raise ConfigurationError(
            f"sensor '{spec.name}' has a delay of {spec.delay:g} s, which must be a multiple of its period "
            f"of {1.0 / spec.rate:g} s"
        )
    return periods


def _replace(old: Tensor, env_ids: Tensor | None, new: Tensor) -> Tensor:
    return new if env_ids is None else old.index_copy(0, env_ids, new)
