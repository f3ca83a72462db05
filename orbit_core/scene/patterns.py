"""Textures of floors, walls and furniture, computed from a few lines each."""

from __future__ import annotations

import functools

import numpy as np
import numpy.typing as npt

from orbit_core.scene.shapes import Texture

_SIDE = 512
_Array = npt.NDArray[np.float64]


@functools.cache
def grid(width: float = 1.0, cells: int = 4, light: float = 1.0, dark: float = 0.93, line: float = 0.82) -> Texture:
    """Build a chequered floor with thin lines around its cells.

    Args:
        width: metres of the whole pattern.
        cells: cells along it, an even number, so that the pattern repeats.
        light: brightness of every other cell.
        dark: brightness of the cells between.
        line: brightness of the lines.
    """
    place = (np.arange(_SIDE) + 0.5) * cells / _SIDE
    number = place.astype(np.int64)
    gray = np.where((number[:, None] + number) % 2 == 0, light, dark)
    # Two pixels at the border of a cell, so that lines stay visible after the picture is filtered.
    border = np.abs(place - np.round(place)) < 2.0 * cells / _SIDE
    gray[border | border[:, None]] = line
    return _colored(gray, (1.0, 1.0, 1.0), width)


@functools.cache
def wood(width: float = 0.9, seed: int = 0) -> Texture:
    """Build planks of light wood along the picture's rows, without a seam at its borders."""
    planks, random = 4, np.random.default_rng(seed)
    rows = np.arange(_SIDE) * planks // _SIDE
    # Noise that is long along the grain, another one in each plank.
    fibres = _noise(random, (1.5, 60.0)) * 0.6 + _noise(random, (3.0, 24.0)) * 0.4
    shifts = random.integers(0, _SIDE, planks)[rows]
    fibres = fibres[np.arange(_SIDE)[:, None], (np.arange(_SIDE) + shifts[:, None]) % _SIDE]
    rings = np.sin(2.0 * np.pi * (7.0 * np.arange(_SIDE)[:, None] * planks / _SIDE + 1.6 * fibres))
    gray = 0.9 + 0.05 * fibres + 0.025 * rings + random.uniform(-0.03, 0.03, planks)[rows][:, None]
    joint = np.abs((np.arange(_SIDE) + 0.5) * planks / _SIDE - rows - 0.5) > 0.5 - 1.5 * planks / _SIDE
    gray[joint] *= 0.86
    return _colored(gray, (1.0, 0.985, 0.96), width)


@functools.cache
def concrete(width: float = 2.0, seed: int = 0) -> Texture:
    """Build cast concrete: clouds, and fine grain with a few pores."""
    random = np.random.default_rng(seed)
    grain = random.standard_normal((_SIDE, _SIDE))
    gray = 0.95 + 0.035 * _noise(random, (4.0, 4.0)) + 0.02 * _noise(random, (20.0, 20.0)) + 0.01 * grain
    gray[grain > 3.5] -= 0.12
    return _colored(gray, (1.0, 1.0, 1.0), width)


def _noise(random: np.random.Generator, waves: tuple[float, float]) -> _Array:
    """Return smooth noise of deviation 1 with so many waves along columns and rows; it repeats without a seam."""
    number = np.fft.fftfreq(_SIDE, 1.0 / _SIDE)
    along, across = waves
    weight = np.exp(-((number / along) ** 2) - ((number / across) ** 2)[:, None])
    values = np.fft.ifft2(np.fft.fft2(random.standard_normal((_SIDE, _SIDE))) * weight).real
    return (values - values.mean()) / values.std()


def _colored(gray: _Array, tint: tuple[float, float, float], width: float) -> Texture:
    pixels = 255.0 * np.clip(gray[..., None] * np.asarray(tint), 0.0, 1.0) + 0.5
    return Texture(pixels.astype(np.uint8), width)
