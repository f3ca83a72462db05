"""Propagation in free air: each body's sound arrives late by its distance, and weaker by it."""

from __future__ import annotations

import math

import torch
from torch import Tensor

from orbit_core.dynamics.indexing import write_rows
from orbit_sound.modes import SPEED_OF_SOUND

_NEAREST = 0.1  # m: closer than this a body is no point, and its level grows no more
# Samples on either side of a fraction of a sample: within 0.5 dB up to 0.4 of the sampling rate. Linear interpolation
# would take up to 8 dB from there.
_HALF = 6
_KAISER = 4.0
_PHASES = 512  # fractions for which filters are kept: the nearest is 50 dB better than none


class Propagation:
    """Delay lines (N, S) from bodies to a microphone.

    Delays change linearly within a chunk, so that a body that passes by is heard with its Doppler shift.

    Args:
        num_envs: number N of environments.
        bodies: number S of bodies.
        sampling_rate: Hz.
        chunk: samples K of each call.
        reach: m from which on a body is not heard.
        device: of all tensors.
    """

    def __init__(
        self, num_envs: int, bodies: int, sampling_rate: float, chunk: int, reach: float, device: torch.device
    ) -> None:
        self._per_metre = sampling_rate / SPEED_OF_SOUND
        self._reach = reach
        self._length = math.ceil(reach * self._per_metre) + chunk + 2 * _HALF
        self._line = torch.zeros(num_envs, bodies, self._length, device=device)
        # A negative delay is that of an environment that has not sounded since its reset.
        self._delay = torch.full((num_envs, bodies), -1.0, device=device)
        # Where the next chunk is written. A tensor: a traced step repeats what it does with it.
        self._head = torch.zeros((), dtype=torch.int64, device=device)
        self._samples = torch.arange(chunk, device=device)
        self._offsets = torch.arange(1 - _HALF, _HALF + 1, device=device)
        self._weights = _fraction_filters().to(device)

    @property
    def state(self) -> tuple[Tensor, Tensor, Tensor]:
        """Lines, last delays and write position; to be saved and loaded."""
        return self._line, self._delay, self._head

    def carry(self, sound: Tensor, distance: Tensor) -> Tensor:
        """Return what arrives (N, S, K) of each body while the bodies emit ``sound`` (N, S, K), given at 1 m.

        Args:
            sound: (N, S, K) Pa at 1 m.
            distance: (N, S) m at the chunk's end.
        """
        places = self._head + self._samples
        self._line.index_copy_(2, places % self._length, sound)
        # Samples after the fraction must have been written: the shortest delay is that of 13 cm at 16 kHz.
        target = (distance.clamp_max(self._reach) * self._per_metre).clamp_min(_HALF)
        before = torch.where(self._delay < 0.0, target, self._delay)
        part = (self._samples + 1.0) / len(self._samples)
        delay = before[..., None] + (target - before)[..., None] * part
        when = self._samples - delay
        floor = when.floor()
        near = (self._head + floor.long())[..., None] + self._offsets
        weights = self._weights[((when - floor) * _PHASES).round().long()]
        arrived = (self._line.gather(2, near.flatten(2) % self._length).view(weights.shape) * weights).sum(-1)
        self._delay.copy_(target)
        self._head.copy_((self._head + len(self._samples)) % self._length)
        level = torch.where(distance <= self._reach, 1.0 / distance.clamp_min(_NEAREST), 0.0)
        return arrived * level[..., None]

    def reset(self, env_ids: Tensor | None) -> None:
        """Empty the lines of some environments."""
        write_rows(self._line, 0.0, env_ids)
        write_rows(self._delay, -1.0, env_ids)


def _fraction_filters() -> Tensor:
    """Return filters (phases + 1, 2 half) that read between samples: sincs in Kaiser's window."""
    lag = torch.arange(_PHASES + 1)[:, None] / _PHASES - torch.arange(1 - _HALF, _HALF + 1)
    window = torch.special.i0(_KAISER * (1.0 - (lag / _HALF).square()).clamp_min(0.0).sqrt())
    return torch.sinc(lag) * window / torch.special.i0(torch.tensor(_KAISER))
