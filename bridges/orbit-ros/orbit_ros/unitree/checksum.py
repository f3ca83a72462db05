"""Checksum of Unitree's messages: CRC-32 over 32-bit words of the C layout, unreflected, without a final inversion."""

from __future__ import annotations

import zlib

import numpy as np
import numpy.typing as npt

# Bits of each byte in the opposite order: zlib computes the reflected form of the same polynomial.
_REVERSED = np.array([int(f"{byte:08b}"[::-1], 2) for byte in range(256)], np.uint8)


def checksum(data: npt.NDArray[np.uint8]) -> int:
    """Return the checksum of little-endian words.

    Args:
        data: (4 n,) bytes of the C layout without its last word.
    """
    # Words are taken in from their highest bit, so their bytes change places.
    words = _REVERSED[data.reshape(-1, 4)[:, ::-1]]
    reflected = zlib.crc32(words.tobytes()) ^ 0xFFFFFFFF
    return int(f"{reflected:032b}"[::-1], 2)
