"""What happens to a measurement before a policy sees it: scale, bias, white noise, saturation, delay."""

from __future__ import annotations

from dataclasses import replace

import torch
from torch import Tensor

from orbit_core.dynamics.indexing import write_rows
from orbit_core.envs.observation_history import Past
from orbit_core.envs.terms import ObservationTerm
from orbit_core.interfaces import ConfigurationError, World


class Corruption:
    """Corrupts the values (N, ...) of one term, of any shape; noise and bias differ in each component.

    Args:
        term: says what happens.
        value: (N, ...) one like those to come.
        world: whose environments draw.
        what: the term, for messages.

    Raises:
        ConfigurationError: the delay or the bounds cannot be, or whole numbers are to be scaled or made noisy.
    """

    def __init__(self, term: ObservationTerm, value: Tensor, world: World, what: str) -> None:
        self._term = term = replace(term)  # as it is now: it may be set later
        self._world = world
        noisy = bool(term.noise_std or term.bias_std)
        if (noisy or term.scale != 1.0) and not value.is_floating_point():
            raise ConfigurationError(
                f"{what} gives {value.dtype}: scale, noise and bias need torch.float32, so convert it in its function"
            )
        self._saturation = term.bounds if noisy else None
        self._shape = tuple(value.shape[1:])
        self._bias = torch.zeros_like(value) if term.bias_std else None
        self._delay = _Delay(term.delay, value, world, what) if term.delay != (0, 0) else None
        self.changes = noisy or term.scale != 1.0 or self._delay is not None
        """False where values are seen as they are."""

    def __call__(self, value: Tensor) -> Tensor:
        """What is seen of this step's value."""
        term = self._term
        if term.scale != 1.0:
            value = value * term.scale
        if self._bias is not None:
            value = value + self._bias
        if term.noise_std:
            value = value + self._world.random.normal(self._shape, term.noise_std)
        if self._saturation is not None:
            value = value.clamp(*self._saturation)
        return value if self._delay is None else self._delay(value)

    def take_over(self, before: Corruption, what: str) -> None:
        """Go on with what another corruption of the same measurement remembers; a new bias is drawn now.

        Raises:
            ConfigurationError: the delay is another.
        """
        if self._term.delay != before._term.delay:
            raise ConfigurationError(
                f"the delay of {what} is {self._term.delay}, but was {before._term.delay} when the environment was "
                "made: change it before"
            )
        self._delay = before._delay
        if self._bias is not None and self._term.bias_std == before._term.bias_std:
            self._bias = before._bias
        else:
            self.draw_bias(None)

    def draw_bias(self, env_ids: Tensor | None) -> None:
        """Draw the errors that an episode keeps, by index or mask."""
        if self._bias is not None:
            drawn = self._world.random.normal(self._shape, self._term.bias_std, env_ids)
            write_rows(self._bias, drawn, env_ids)

    def draw_delay(self, env_ids: Tensor | None) -> None:
        """Draw how late an episode's measurements are, by index or mask."""
        if self._delay is not None:
            self._delay.reset(env_ids)


class _Delay:
    """Holds measurements back by the steps that each environment draws at reset."""

    def __init__(self, delay: tuple[int, int], value: Tensor, world: World, what: str) -> None:
        self._fewest, self._most = delay
        if not 0 <= self._fewest <= self._most:
            raise ConfigurationError(f"the delay of {what} must be 0 <= fewest <= most steps, not {delay}")
        self._random = world.random
        self._past = Past(world, value, self._most + 1)
        self._steps = torch.zeros(len(value), dtype=torch.int64, device=value.device)

    def reset(self, env_ids: Tensor | None) -> None:
        write_rows(self._steps, self._random.integers(self._fewest, self._most, env_ids), env_ids)
        self._past.reset(env_ids)

    def __call__(self, value: Tensor) -> Tensor:
        steps = self._steps.view(-1, *(1 for _ in value.shape)).expand_as(value[:, None])
        return self._past.push(value).gather(1, steps).squeeze(1)
