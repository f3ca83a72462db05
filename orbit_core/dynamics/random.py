"""One random stream per environment: environment i draws the same numbers for any number of environments."""

from __future__ import annotations

import functools
import math
from typing import Any

import torch
from torch import Tensor

from orbit_core.dynamics.arguments import seed_number
from orbit_core.dynamics.indexing import RowSelector, is_mask, take_rows, write_rows
from orbit_core.interfaces.capture import is_tracing

_INCREMENT = -7046029254386353131  # 0x9E3779B97F4A7C15, as a signed 64-bit integer
_MIX_1 = -4658895280553007687  # 0xBF58476D1CE4E5B9
_MIX_2 = -7723592293110705685  # 0x94D049BB133111EB

Bound = float | tuple[float, ...] | Tensor
# int64: NumPy's on the CPU, where an operation on few numbers costs a third of torch's; torch's elsewhere
_Array = Any


class RandomStreams:
    """Counter-based generator: a draw is a hash of (seed, environment, episode, index of the draw).

    The hash is SplitMix64 (Steele, Lea and Flood, Fast Splittable Pseudorandom Number Generators, OOPSLA 2014), whose
    finaliser takes any counter to 64 well-mixed bits, so that all environments draw in one batched call.
    """

    def __init__(self, num_envs: int, seed: int, device: torch.device, selector: RowSelector | None = None) -> None:
        self.device = device
        """Device that numbers are drawn on."""
        self.selector = selector or RowSelector(num_envs, device)
        """Mask of environments that draw; others keep their counters."""
        self._envs: _Array = _array(torch.arange(num_envs, dtype=torch.int64, device=device))
        self._key: _Array = self._envs * 0
        self._episode: _Array = self._envs * 0
        # What the last draw hashed: it starts at a hash of key and episode, and grows by the increment
        self._counter: _Array = self._envs * 0
        self.seed(seed)

    def seed(self, seed: int, env_ids: Tensor | None = None) -> None:
        """Restart the streams of some environments from a seed, before their first episode.

        Raises:
            ArgumentError: the seed is not 0 to 2^63 - 1, or ``env_ids`` are no environments.
        """
        seed = seed_number(seed)
        ids = self._rows(self.selector.resolve(env_ids))
        self._key[ids] = _mix(_mix(ids * 0 + seed + _INCREMENT) + ids * _INCREMENT)
        self._begin_stream(ids, ids * 0 - 1)

    def reset(self, env_ids: Tensor | None = None) -> None:
        """Begin the next episode's stream; what the last episode drew does not matter to it."""
        env_ids = self.selector.resolve(env_ids)
        if is_mask(env_ids):
            key, episode, counter = self._tensors
            following = episode + 1
            write_rows(episode, following, env_ids)
            write_rows(counter, _mix(key + following * _INCREMENT), env_ids)
            return
        ids = self._rows(env_ids)
        self._begin_stream(ids, self._episode[ids] + 1)

    @property
    def episode(self) -> Tensor:
        """Number (N,) of each environment's episode, from 0; -1 before the first."""
        return self._tensors[1]

    def begin(self, episode: Tensor) -> None:
        """Begin the streams of given episodes (N,), in the environments that are in others."""
        key, own, counter = self._tensors
        other = own != episode
        write_rows(counter, _mix(key + episode * _INCREMENT), other)
        write_rows(own, episode, other)

    def uniform(
        self, shape: tuple[int, ...], low: Bound = 0.0, high: Bound = 1.0, env_ids: Tensor | None = None
    ) -> Tensor:
        """Draw numbers (n, *shape), float32 in [low, high).

        Args:
            shape: of one environment's draw.
            low: number, or tuple or tensor that broadcasts to ``shape``.
            high: the same.
            env_ids: environments that draw; all if None.
        """
        # The top 24 bits fill a float32's mantissa exactly.
        bits = (self._bits(math.prod(shape), env_ids) >> 40) & 0xFFFFFF
        steps = torch.as_tensor(bits).to(torch.float32).view(-1, *shape)
        low, high = (self._bound(bound) for bound in (low, high))
        return low + ((high - low) * 2.0**-24) * steps

    def normal(self, shape: tuple[int, ...], std: float | Tensor = 1.0, env_ids: Tensor | None = None) -> Tensor:
        """Return (n, *shape) float32 of mean zero (Box and Muller, 1958)."""
        u = self.uniform((2, *shape), env_ids=env_ids)
        radius = torch.sqrt(-2.0 * torch.log1p(-u[:, 0]))
        return std * radius * torch.cos(2.0 * math.pi * u[:, 1])

    def integers(self, low: int, high: int, env_ids: Tensor | None = None) -> Tensor:
        """Return (n,) int64 in [low, high]."""
        return low + (self.uniform((), env_ids=env_ids) * (high - low + 1)).to(torch.int64)

    def save_state(self) -> tuple[Tensor, Tensor, Tensor]:
        """Return detached copy of all streams."""
        key, episode, counter = (own.clone() for own in self._tensors)
        return key, episode, counter

    def load_state(self, state: tuple[Tensor, Tensor, Tensor]) -> None:
        """Return to a saved state."""
        for own, saved in zip((self._key, self._episode, self._counter), state, strict=True):
            own[:] = _array(saved)

    @property
    def _tensors(self) -> tuple[Tensor, Tensor, Tensor]:
        key, episode, counter = (torch.as_tensor(own) for own in (self._key, self._episode, self._counter))
        return key, episode, counter

    def _rows(self, env_ids: Tensor | None) -> _Array:
        return self._envs if env_ids is None else _array(env_ids)

    def _begin_stream(self, ids: _Array, episode: _Array) -> None:
        self._episode[ids] = episode
        self._counter[ids] = _mix(self._key[ids] + episode * _INCREMENT)

    def _bits(self, draws: int, env_ids: Tensor | None) -> _Array:
        env_ids = self.selector.resolve(env_ids)
        if is_tracing() or is_mask(env_ids):
            counter = self._tensors[2]
            chosen = take_rows(counter, env_ids)
            counters = chosen[:, None] + torch.as_tensor(_increments(draws, self.device))
            write_rows(counter, counters[:, -1], env_ids)
        else:
            ids = self._rows(env_ids)
            counters = self._counter[ids][:, None] + _increments(draws, self.device)
            self._counter[ids] = counters[:, -1]
        return _mix(counters[:, 1:])

    def _bound(self, bound: Bound) -> float | Tensor:
        return _constant(bound, self.device) if isinstance(bound, tuple) else bound


def _array(tensor: Tensor) -> _Array:
    """Return the tensor's own memory."""
    return tensor.numpy() if tensor.device.type == "cpu" else tensor


@functools.lru_cache(maxsize=64)
def _increments(draws: int, device: torch.device) -> _Array:
    """Return (draws + 1,) of the counter: zero first."""
    return _array(torch.arange(draws + 1, device=device) * _INCREMENT)


@functools.lru_cache(maxsize=64)
def _constant(values: tuple[float, ...], device: torch.device) -> Tensor:
    return torch.tensor(values, dtype=torch.float32, device=device)


def _mix(z: _Array) -> _Array:
    z = (z ^ _shift_right(z, 30)) * _MIX_1
    z = (z ^ _shift_right(z, 27)) * _MIX_2
    return z ^ _shift_right(z, 31)


def _shift_right(z: _Array, bits: int) -> _Array:
    # A signed integer is shifted arithmetically; the mask makes the shift logical.
    return (z >> bits) & ((1 << (64 - bits)) - 1)
