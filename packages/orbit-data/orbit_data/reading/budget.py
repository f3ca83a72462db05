"""Limits on what reading a file of data may take of the machine, and the account of one reading."""

from __future__ import annotations

import math
import time
from dataclasses import dataclass

from orbit_core.interfaces import ConfigurationError

SMALL = 1 << 24
"""Bytes of an array, or of a chunk of it, that are read however little is stored of them."""
DENSEST = 1000
"""Most bytes of an array for each byte that is stored of it, about as many as gzip makes of zeros."""
MAX_DOCUMENT = 1 << 22
"""Most bytes of a JSON document that describes data."""
_USUAL = 1 << 28
"""Bytes of a file of which the budget's seconds are asked."""
_MOST_CHARACTERS = 200
"""Most characters of a name in a file."""


@dataclass(frozen=True)
class ReadBudget:
    """Limits on what reading datasets and recordings may take; more is refused before it is taken."""

    bytes: int = 2**30
    """Most bytes of an episode's arrays, or of a recording, once unpacked."""
    pixels: int = 2**24
    """Most pixels of one picture of a video."""
    seconds: float = 10.0
    """Longest time that opening a dataset, or reading one episode or recording, may take, s.

    A file of HDF5 of more than 256 MiB may take as many times longer to open: it may hold as many more episodes.
    """

    def __post_init__(self) -> None:
        """Check the limits.

        Raises:
            ConfigurationError: one is not above zero.
        """
        for name in ("bytes", "pixels", "seconds"):
            if not getattr(self, name) > 0:
                raise ConfigurationError(f"{name} of a ReadBudget must be above zero, not {getattr(self, name)}")


TRUSTED = ReadBudget(bytes=2**62, pixels=2**62, seconds=math.inf)
"""Budget of files that this process has written."""


class ReadAccount:
    """Bytes and time that one reading has taken of its budget.

    Args:
        budget: that the reading is held to.
        where: the file, for messages.
        size: bytes on the disk of what is opened, where the time may grow with it.
    """

    def __init__(self, budget: ReadBudget, where: str, size: int = 0) -> None:
        self.budget = budget
        self.where = where
        self._left = budget.bytes
        self._seconds = budget.seconds * max(1.0, size / _USUAL)
        self._end = time.monotonic() + self._seconds

    def take(self, name: str, size: int, stored: int | None = None) -> None:
        """Count bytes before memory is taken for them.

        Args:
            name: of the array, for messages.
            size: bytes of it.
            stored: bytes of the file that it is unpacked from, where they can be fewer.

        Raises:
            ConfigurationError: the budget does not hold so many, or next to nothing is stored of them.
        """
        if stored is not None and size > max(SMALL, DENSEST * stored):
            raise ConfigurationError(
                f"'{name}' of {self.where} would be {size / 1e9:.3g} GB, of which next to nothing is stored: the file "
                "is truncated or made to fill the memory"
            )
        if size > self._left:
            raise ConfigurationError(
                f"{self.where} would take {self.budget.bytes - self._left + size:,} bytes with '{name}', and "
                f"{self.budget.bytes:,} are allowed: raise ReadBudget.bytes (--read-bytes) if you trust it"
            )
        self._left -= size

    def check_time(self) -> None:
        """Stop a reading that has taken too long.

        Raises:
            ConfigurationError: it has.
        """
        if time.monotonic() > self._end:
            raise ConfigurationError(
                f"{self.where} was not read within {self._seconds:g} s: raise ReadBudget.seconds "
                "(--read-seconds) if you trust it"
            )

    def check_picture(self, name: str, width: int, height: int) -> None:
        """Refuse a picture that has too many pixels.

        Raises:
            ConfigurationError: names the video and the size.
        """
        if width * height > self.budget.pixels:
            raise ConfigurationError(
                f"'{name}' of {self.where} has pictures of {width} x {height}, and {self.budget.pixels:,} pixels are "
                "allowed: raise ReadBudget.pixels (--read-pixels) if you trust it"
            )


def check_name(name: str, where: str) -> None:
    """Refuse a name that could not be printed or that is a path.

    Raises:
        ConfigurationError: shows it.
    """
    if not name.isprintable() or name in ("", ".", "..") or "/" in name or len(name) > _MOST_CHARACTERS:
        raise ConfigurationError(f"{where} holds {name[:60]!a}, which is no name of an array")
