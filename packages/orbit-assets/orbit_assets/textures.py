"""Textures: chequers, blotches, and pictures from files."""

from __future__ import annotations

import io
from dataclasses import replace
from pathlib import Path

import numpy as np

from orbit_core.interfaces import AssetError
from orbit_core.scene import Texture

# Pixels of a side: a picture of 2 by 2 squares needs few, blotches with waves of 2^5 need 8 per wave.
_SIDE = 256
# Most pixels of a picture file; a larger one is rejected before it is decoded.
_LARGEST = 64 * 1024 * 1024
# Formats that Pillow decodes itself; for PostScript it runs a program.
_FORMATS = ("PNG", "JPEG", "BMP", "GIF", "PPM", "TGA", "TIFF", "WEBP")

Gray = float
"""A brightness in [0, 1]."""


def checker(width: float = 0.1, dark: Gray = 0.2, light: Gray = 1.0) -> Texture:
    """Build two by two squares, dark and light, ``width`` metres across all of them."""
    squares = np.indices((_SIDE, _SIDE)) * 2 // _SIDE
    return Texture(_gray(np.where(squares.sum(0) % 2 == 0, light, dark)), width)


def stripes(width: float = 0.05, dark: Gray = 0.2, light: Gray = 1.0) -> Texture:
    """Build upright stripes, a dark and a light one in ``width`` metres."""
    return Texture(_gray(np.where(np.arange(_SIDE) * 2 < _SIDE, light, dark) * np.ones((_SIDE, 1))), width)


def blotches(seed: int, width: float = 0.2, finest: int = 5, dark: Gray = 0.1, light: Gray = 1.0) -> Texture:
    """Build smooth random blotches without a seam: waves of 1 to ``2^finest`` in ``width`` metres.

    The power of a wave falls with the square of its number, as in pictures of nature (Field, Relations between the
    Statistics of Natural Images and the Response Properties of Cortical Cells, 1987). One seed gives one texture.
    """
    random = np.random.default_rng(seed)
    numbers = np.fft.fftfreq(_SIDE, 1.0 / _SIDE)
    waves = np.hypot(*np.meshgrid(numbers, numbers))
    inside = (waves >= 1.0) & (waves <= 2.0**finest)
    # Noise filtered in the frequency domain is periodic: it has no seam.
    power = np.where(inside, 1.0 / np.maximum(waves, 1.0), 0.0)
    height = np.fft.ifft2(np.fft.fft2(random.standard_normal((_SIDE, _SIDE))) * power).real
    least, most = height.min(), height.max()
    return Texture(_gray(dark + (light - dark) * (height - least) / (most - least)), width)


def texture_file(path: str | Path, width: float = 0.2) -> Texture:
    """Read a picture file (PNG, JPEG, BMP, GIF, PPM, TGA, TIFF or WebP; needs Pillow), ``width`` metres wide.

    Raises:
        AssetError: there is none, it is no picture, or one of more than 64 million pixels; or Pillow is missing.
    """
    try:
        data = Path(path).read_bytes()
    except OSError as error:
        raise AssetError(f"texture '{path}' cannot be read as a picture: {error}") from None
    return replace(decoded_texture(data, str(path), _LARGEST, finest=None), width=width)


def decoded_texture(data: bytes, name: str, pixels: int, finest: int | None = 1024) -> Texture:
    """Decode the bytes of a picture.

    Args:
        data: content of a PNG, JPEG, BMP, GIF, PPM, TGA, TIFF or WebP file.
        name: for messages.
        pixels: most pixels, which are compared before the picture is decoded.
        finest: most pixels of a side, to which it is made smaller; None keeps all.

    Raises:
        AssetError: it is no picture, or one of more pixels; or Pillow is missing.
    """
    try:
        from PIL import Image, UnidentifiedImageError
    except ImportError:
        raise AssetError(f"reading '{name}' needs Pillow: pip install pillow") from None
    try:
        with Image.open(io.BytesIO(data), formats=_FORMATS) as picture:
            if picture.width * picture.height > pixels:
                raise AssetError(f"texture '{name}' is {picture.width} x {picture.height} pixels: make it smaller")
            whole = picture.convert("RGB")
    except (OSError, UnidentifiedImageError, Image.DecompressionBombError, SyntaxError, ValueError) as error:
        raise AssetError(f"texture '{name}' cannot be read as a picture: {error}") from None
    if finest is not None:
        whole.thumbnail((finest, finest))
    return Texture(np.asarray(whole))


def _gray(values: np.ndarray) -> np.ndarray:
    """Return brightnesses (H, W) in [0, 1] as pixels (H, W, 3)."""
    return np.repeat((255.0 * np.clip(values, 0.0, 1.0) + 0.5).astype(np.uint8)[..., None], 3, axis=2)
