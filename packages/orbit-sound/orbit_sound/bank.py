"""Modal bank: damped sines of many bodies in many environments, a chunk of samples at a time."""

from __future__ import annotations

from collections.abc import Sequence

import torch
from torch import Tensor

from orbit_core.dynamics.indexing import write_rows
from orbit_sound.modes import Modes


class ModalBank:
    """Recursive filters of all modes, exact for any number of samples a chunk.

    A mode's amplitude z decays and turns by ``a = exp((-decay + i omega) / rate)`` each sample, and sounds as its
    imaginary part. Over a chunk of K samples that is two matrix products: by the powers of ``a``, and by the Toeplitz
    matrix of the impulse response. Complex numbers are pairs of real ones, so that a compiled step keeps them.

    Args:
        bodies: modes of S bodies; those above half of the sampling rate are left out.
        num_envs: number N of environments.
        sampling_rate: Hz.
        chunk: samples K.
        device: of all tensors.
    """

    def __init__(
        self, bodies: Sequence[Modes], num_envs: int, sampling_rate: float, chunk: int, device: torch.device
    ) -> None:
        kept = [_below(modes, 0.5 * sampling_rate) for modes in bodies]
        most = max(1, *(len(modes.frequencies) for modes in kept))
        frequencies, decays, gains = (
            torch.tensor([[*values, *(0.0,) * (most - len(values))] for values in rows], dtype=torch.float64)
            for rows in zip(*((m.frequencies, m.decays, m.gains) for m in kept), strict=True)
        )
        self._gains = gains.float().to(device)
        exponent = torch.complex(-decays, 2.0 * torch.pi * frequencies) / sampling_rate
        samples = torch.arange(chunk + 1, dtype=torch.float64)
        powers = torch.exp(exponent[:, :, None] * samples)  # (S, M, K + 1)
        self._end = _pair(powers[:, :, -1], device)
        # Imaginary part of z a^k: the real part of z times sines plus its imaginary part times cosines.
        self._sines = powers.imag[:, :, :-1].float().to(device)
        self._cosines = powers.real[:, :, :-1].float().to(device)
        response = (gains[:, :, None] * powers.imag).sum(1)  # (S, K + 1)
        lag = (samples[None, :chunk] - samples[:chunk, None]).long()
        toeplitz = torch.where(lag >= 0, response[:, lag.clamp_min(0)], 0.0)
        self._toeplitz = toeplitz.float().to(device)
        # Amplitude at the chunk's end that an impulse at each of its samples leaves: (S, K, M)
        left = gains[:, :, None] * powers[:, :, 1:].flip(2)
        self._left = _pair(left.transpose(1, 2).contiguous(), device)
        self._amplitudes = torch.zeros(2, num_envs, len(kept), most, device=device)

    @property
    def amplitudes(self) -> Tensor:
        """Real and imaginary parts (2, N, S, M) of the modes' amplitudes, Pa at 1 m."""
        return self._amplitudes

    def ring(self, hits: Tensor, fresh: Tensor, scrapes: Tensor | None = None) -> Tensor:
        """Advance by one chunk and return the pressures (N, S, K) at 1 m of each body, Pa.

        Args:
            hits: (N, S) impulses in N s at the chunk's first sample.
            fresh: (N, S) bool. A hit that is not fresh continues the one before: engines spread an impact over some
                steps, and their parts add to the amplitude in phase, as the one impact that they are.
            scrapes: (N, S, K) further impulses in N s at each sample.
        """
        size = self._amplitudes.square().sum(0).sqrt()
        continued = (size > 0.0) & ~fresh[..., None]
        added = hits[..., None] * self._gains
        ratio = torch.where(continued, added / size.clamp_min(1e-30), 0.0)
        real, imaginary = self._amplitudes * (1.0 + ratio)
        real = real + torch.where(continued, 0.0, added)
        sound = torch.einsum("nsm,smk->nsk", real, self._sines) + torch.einsum("nsm,smk->nsk", imaginary, self._cosines)
        turned = torch.stack(
            (real * self._end[0] - imaginary * self._end[1], real * self._end[1] + imaginary * self._end[0])
        )
        if scrapes is not None:
            sound = sound + torch.einsum("nsj,sjk->nsk", scrapes, self._toeplitz)
            turned = turned + torch.einsum("nsj,csjm->cnsm", scrapes, self._left)
        # What has died away is zero, for numbers below the normal ones slow a processor down.
        self._amplitudes.copy_(torch.where(turned.abs() < 1e-20, 0.0, turned))
        return sound

    def reset(self, env_ids: Tensor | None) -> None:
        """Silence some environments."""
        write_rows(self._amplitudes.transpose(0, 1), 0.0, env_ids)


def _below(modes: Modes, highest: float) -> Modes:
    """Return the modes below a frequency, Hz."""
    kept = [row for row in zip(modes.frequencies, modes.decays, modes.gains, strict=True) if row[0] < highest]
    columns = tuple(zip(*kept, strict=True)) or ((), (), ())
    return Modes(*columns, mass=modes.mass)


def _pair(numbers: Tensor, device: torch.device) -> Tensor:
    return torch.stack((numbers.real, numbers.imag)).float().to(device)
