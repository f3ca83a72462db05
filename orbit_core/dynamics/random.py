"""One random stream per environment: environment i draws the same numbers whatever the number of environments."""

from __future__ import annotations

import math

import torch
from torch import Tensor

_INCREMENT = -7046029254386353131  # 0x9E3779B97F4A7C15, as a signed 64-bit integer
_MIX_1 = -4658895280553007687  # 0xBF58476D1CE4E5B9
_MIX_2 = -7723592293110705685  # 0x94D049BB133111EB


class RandomStreams:
    """Counter-based generator: a draw is a hash of (seed, environment, episode, index of the draw).

    The hash is SplitMix64 (Steele, Lea and Flood, Fast Splittable Pseudorandom Number Generators, OOPSLA 2014), whose
    finaliser takes any counter to 64 well-mixed bits, so that all environments draw in one batched call.
    """

    def __init__(self, num_envs: int, seed: int, device: torch.device) -> None:
        self.device = device
        self._episode = torch.full((num_envs,), -1, dtype=torch.int64, device=device)
        self._count = torch.zeros(num_envs, dtype=torch.int64, device=device)
        self._key = torch.zeros(num_envs, dtype=torch.int64, device=device)
        self._stream = torch.zeros(num_envs, dtype=torch.int64, device=device)
        """Hash of key and episode."""
        self._envs = torch.arange(num_envs, dtype=torch.int64, device=device)
        self.seed(seed)

    def seed(self, seed: int, env_ids: Tensor | None = None) -> None:
        """Start the streams of some environments anew from a seed, before their first episode."""
        ids = self._envs if env_ids is None else env_ids
        self._key[ids] = _mix(_mix(torch.full_like(ids, seed) + _INCREMENT) + ids * _INCREMENT)
        self._episode[ids] = -1
        self._begin_stream(ids)

    def reset(self, env_ids: Tensor | None = None) -> None:
        """Begin the next episode's stream; what the last episode drew does not matter to it."""
        ids = self._envs if env_ids is None else env_ids
        self._episode[ids] += 1
        self._begin_stream(ids)

    def uniform(
        self,
        shape: tuple[int, ...],
        low: float | Tensor = 0.0,
        high: float | Tensor = 1.0,
        env_ids: Tensor | None = None,
    ) -> Tensor:
        """(n, *shape) float32 in [low, high)."""
        bits = self._bits(math.prod(shape), env_ids)
        # The top 24 bits fill a float32's mantissa exactly.
        unit = ((bits >> 40) & 0xFFFFFF).to(torch.float32) * 2.0**-24
        return low + (high - low) * unit.view(-1, *shape)

    def normal(self, shape: tuple[int, ...], std: float | Tensor = 1.0, env_ids: Tensor | None = None) -> Tensor:
        """(n, *shape) float32 of mean zero (Box and Muller, 1958)."""
        u = self.uniform((2, *shape), env_ids=env_ids)
        radius = torch.sqrt(-2.0 * torch.log1p(-u[:, 0]))
        return std * radius * torch.cos(2.0 * math.pi * u[:, 1])

    def integers(self, low: int, high: int, env_ids: Tensor | None = None) -> Tensor:
        """(n,) int64 in [low, high]."""
        return low + (self.uniform((), env_ids=env_ids) * (high - low + 1)).to(torch.int64)

    def save_state(self) -> tuple[Tensor, Tensor, Tensor]:
        """Detached copy of all streams."""
        return self._key.clone(), self._episode.clone(), self._count.clone()

    def load_state(self, state: tuple[Tensor, Tensor, Tensor]) -> None:
        """Return to a saved state."""
        for own, saved in zip((self._key, self._episode, self._count), state, strict=True):
            own.copy_(saved)
        self._stream.copy_(self._stream_of(self._envs))

    def _begin_stream(self, ids: Tensor) -> None:
        self._stream[ids] = self._stream_of(ids)
        self._count[ids] = 0

    def _stream_of(self, ids: Tensor) -> Tensor:
        return _mix(self._key[ids] + self._episode[ids] * _INCREMENT)

    def _bits(self, draws: int, env_ids: Tensor | None) -> Tensor:
        ids = self._envs if env_ids is None else env_ids
        count = self._count[ids]
        self._count[ids] = count + draws
        counter = count[:, None] + torch.arange(1, draws + 1, device=self.device)
        return _mix(self._stream[ids, None] + counter * _INCREMENT)


def _mix(z: Tensor) -> Tensor:
    z = (z ^ _shift_right(z, 30)) * _MIX_1
    z = (z ^ _shift_right(z, 27)) * _MIX_2
    return z ^ _shift_right(z, 31)


def _shift_right(z: Tensor, bits: int) -> Tensor:
    # Torch shifts signed integers arithmetically; the mask makes the shift logical.
    return (z >> bits) & ((1 << (64 - bits)) - 1)
