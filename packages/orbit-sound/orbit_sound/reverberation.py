"""Reverberation: convolution of each body's sound with the room's response, a reading at a time."""

from __future__ import annotations

import torch
from torch import Tensor

from orbit_core.dynamics.indexing import write_rows


class Reverberation:
    """Overlap-add convolution with responses that all environments share.

    Args:
        responses: (S, L) of each body, at 1 m.
        num_envs: number N of environments.
        block: samples W of each call.
    """

    def __init__(self, responses: Tensor, num_envs: int, block: int) -> None:
        self._block = block
        length = responses.shape[1] + block - 1
        # A size of small factors: transforms of a prime length take many times as long.
        self._size = 1 << (length - 1).bit_length()
        self._spectra = torch.fft.rfft(responses, self._size)
        self._tail = torch.zeros(num_envs, self._size, device=responses.device)

    @property
    def tail(self) -> Tensor:
        """Pressures (N, size) in Pa that are still to be heard."""
        return self._tail

    def add(self, sound: Tensor) -> Tensor:
        """Return what the walls reflect (N, W) within the next block while bodies emit ``sound`` (N, S, W) at 1 m."""
        spectra = (torch.fft.rfft(sound, self._size) * self._spectra).sum(1)
        tail = self._tail + torch.fft.irfft(spectra, self._size)
        reflected = tail[:, : self._block]
        rest = torch.zeros_like(reflected)
        self._tail.copy_(torch.cat((tail[:, self._block :], rest), 1))
        return reflected

    def reset(self, env_ids: Tensor | None) -> None:
        """Silence some environments."""
        write_rows(self._tail, 0.0, env_ids)
