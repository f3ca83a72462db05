"""Base of all sensors: timer, delay, noise, held value, and averages over a period."""

from __future__ import annotations

import math
from abc import abstractmethod
from collections.abc import Callable, Hashable, Iterator, MutableMapping
from dataclasses import dataclass, field
from typing import Any, ClassVar

import torch
from torch import Tensor

from orbit_core.dynamics.indexing import is_mask, take_rows, write_rows
from orbit_core.dynamics.random import RandomStreams
from orbit_core.interfaces import ConfigurationError, Engine, Renderer, SceneLayout, Sensor
from orbit_core.interfaces.capture import is_tracing, report_new_memory
from orbit_core.scene import SensorSpec


@dataclass
class SensorContext:
    """``renderer`` is called on first use only, so that a scene whose cameras nobody reads makes none."""

    engine: Engine
    """Engine that is measured."""
    layout: SceneLayout
    """Numbers of the scene's links and joints."""
    physics_dt: float
    """Seconds of a physics step."""
    random: RandomStreams
    """Streams that noise is drawn from."""
    renderer: Callable[[], Renderer]
    gravity: Tensor = field(init=False)
    """(N, 3) m/s^2; whoever changes the engine's gravity writes it here too, for IMUs."""

    def __post_init__(self) -> None:
        gravity = torch.tensor(self.layout.scene.gravity, dtype=torch.float32, device=self.engine.device)
        self.gravity = gravity.repeat(self.engine.num_envs, 1)


class Memory(MutableMapping[str, Tensor]):
    """Tensors by name. A tensor that was handed out stays as it was: another is put in its place.

    From the first step on that is traced they are written in place instead, for a trace repeats what it did to the very
    same memory: clone then what you keep.
    """

    def __init__(self) -> None:
        self._tensors: dict[str, Tensor] = {}
        self._pinned = False

    def __getitem__(self, name: str) -> Tensor:
        return self._tensors[name]

    def __setitem__(self, name: str, value: Tensor) -> None:
        self._pinned |= is_tracing()
        own = self._tensors.get(name)
        if own is not None and self._pinned:
            own.copy_(value)
        else:  # what is expanded has several elements at one place, and cannot be written
            self._tensors[name] = value.clone() if 0 in value.stride() else value
            report_new_memory()

    def __delitem__(self, name: str) -> None:
        del self._tensors[name]

    def __iter__(self) -> Iterator[str]:
        return iter(self._tensors)

    def __len__(self) -> int:
        return len(self._tensors)

    def saved(self) -> dict[str, Tensor]:
        """Return a detached copy."""
        return {name: tensor.clone() for name, tensor in self._tensors.items()}

    def load(self, saved: dict[str, Tensor]) -> None:
        """Return to a copy."""
        for name in self._tensors.keys() - saved.keys():
            del self._tensors[name]
        for name, tensor in saved.items():
            self[name] = tensor.clone()


def with_rows(old: Tensor, values: Tensor, env_ids: Tensor | None, dim: int = 0) -> Tensor:
    """Return ``old`` with the values of some environments, which dimension ``dim`` counts, by index or by mask (N,)."""
    if env_ids is None:
        return values
    if is_mask(env_ids):
        return torch.where(env_ids.view(-1, *(1 for _ in old.shape[dim + 1 :])), values, old)
    return old.index_copy(dim, env_ids, values.expand(*old.shape[:dim], *values.shape[dim:]).contiguous())


Values = dict[str, Tensor]
"""One measurement of some environments: each tensor (n, ...)."""

_RATE_TOLERANCE = 1e-4  # time steps such as 1/120 s are written with few digits


class TimedSensor(Sensor):
    """Measures at its rate, holds back by its delay, adds its noise, and keeps the value in between.

    A sensor without a rate measures at the first read after the world has stepped, and costs nothing unread. A sensor
    with a rate measures when it is due, read or not, for the state will be gone later. Its due times are multiples of
    its period on the world's clock, which a reset leaves running. A reset environment's next reading is fresh (that of
    the first read, or of the next step's start), and fills all of its delayed past. Writing state without a step
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
        """Description in the scene."""
        self.engine = context.engine
        """Engine that is measured."""
        self.num_envs = context.engine.num_envs
        """Number N of environments."""
        self.device = context.engine.device
        """Device of all tensors."""
        self.physics_dt = context.physics_dt
        """Seconds of a physics step."""
        self.period = period_in_steps(spec, context.physics_dt)
        """Physics steps between measurements; None measures whenever the world steps."""
        self._random = context.random
        self._selector = context.random.selector
        self._delay = _delay_in_periods(spec)
        self._lazy = self.period is None or (self.period == 1 and self._delay == 0)
        # Whether the sensor's value is a function of the present state alone, and is measured again when in doubt.
        self._fleeting = self._lazy and not self._noisy and not self.costly
        # True while the value of a fleeting sensor is that of the present state.
        self._measured = False
        self._elapsed = 0
        self._outdated = True
        # Whether nothing was measured yet, or since all environments were reset
        self._empty = True
        self._some_wait = False
        # (N,) environments that were reset and not measured since
        self._waiting = torch.zeros(self.num_envs, dtype=torch.bool, device=self.device)
        # Values of a fleeting sensor at the present state.
        self._present: Values = {}
        # Last measurements (1 + delay, N, ...) of all other sensors, the newest first.
        self._held = Memory()
        self._bias = Memory()

    @property
    def stretch(self) -> int | None:
        """Most physics steps that the engine may run before the sensor looks; None for any number."""
        return self.period

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
        """Return all that later readings depend on, without the engine's state."""
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
        """Return the held value (N, ...) of that name."""
        self._settle()
        return self._present[name] if self._fleeting else self._held[name][-1]

    def _noise(self, name: str, shape: tuple[int, ...], env_ids: Tensor | None) -> Tensor:
        """Return a draw (n, *shape) of white noise plus the value's bias."""
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
    """Return physics steps between two measurements; None without a rate.

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


# Longest delay in periods of a sensor, for each of which a value is kept
_MOST_PERIODS = 10_000


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
        """Return (N, *shape) the quantity's mean over the last ``steps`` steps, times ``steps``."""

    def _mean(self, env_ids: Tensor | None) -> Tensor:
        """Return (n, *shape) over the window so far; zero in one that is empty."""
        return take_rows(self._sum / self._count.clamp_min(1.0), env_ids)
