"""Limits of the memory and time for reading a data file, and the account of one reading."""

from __future__ import annotations

import math
import time
from dataclasses import dataclass

from orbit_core.interfaces import ConfigurationError

SMALL = 1 << 24
"""Bytes of an array, or of a chunk, up to which the compression ratio does not matter."""
DENSEST = 1000
"""Limit of the compression ratio, about that of gzip for zeros."""
MAX_DOCUMENT = 1 << 22
"""Limit of the bytes of a JSON document that describes data."""
# Bytes of a file up to which the budget's seconds apply.
_USUAL = 1 << 28
# Limit of the characters of a name in a file.
_MOST_CHARACTERS = 200


@dataclass(frozen=True)
class ReadBudget:
    """Limits of the memory and time for reading datasets and recordings; more is refused before it is used."""

    bytes: int = 2**30
    """Limit of the bytes of an episode's arrays, or of a recording, once unpacked."""
    pixels: int = 2**24
    """Limit of the pixels of one picture of a video."""
    seconds: float = 10.0
    """Limit in s of opening a dataset, or of reading one episode or recording.

    The limit of opening an HDF5 file above 256 MiB grows with its size, because it may contain more episodes.
    """

    def __post_init__(self) -> None:
        """Check the limits.

        Raises:
            ConfigurationError: a limit is not above zero.
        """
        for name in ("bytes", "pixels", "seconds"):
            if not getattr(self, name) > 0:
                raise ConfigurationError(f"{name} of a ReadBudget must be above zero, not {getattr(self, name)}")


TRUSTED = ReadBudget(bytes=2**62, pixels=2**62, seconds=math.inf)
"""Budget of files that this process has written."""


class ReadAccount:
    """Account of the bytes and time that one reading uses of its budget.

    Args:
        budget: budget of the reading.
        where: name of the file for messages.
        size: bytes of the file on the disk, if the time limit grows with them.
    """

    def __init__(self, budget: ReadBudget, where: str, size: int = 0) -> None:
        self.budget = budget
        self.where = where
        self._left = budget.bytes
        self._seconds = budget.seconds * max(1.0, size / _USUAL)
        self._end = time.monotonic() + self._seconds  # monotonic, because the wall clock can be set

    def take(self, name: str, size: int, stored: int | None = None) -> None:
        """Count bytes before memory is allocated for them.

        Args:
            name: name of the array for messages.
            size: bytes of the array.
            stored: bytes of the file that the array is unpacked from, if it may be compressed.

        Raises:
            ConfigurationError: the budget is exceeded, or the compression ratio is too high to be honest.
        """
        # Before the budget: a larger budget would not help against a file that is made to fill the memory.
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
            ConfigurationError: the time limit has passed.
        """
        if time.monotonic() > self._end:
            raise ConfigurationError(
                f"{self.where} was not read within {self._seconds:g} s: raise ReadBudget.seconds "
                "(--read-seconds) if you trust it"
            )

    def check_picture(self, name: str, width: int, height: int) -> None:
        """Refuse a picture that has too many pixels.

        Raises:
            ConfigurationError: the picture is too large; the message names the video and the size.
        """
        if width * height > self.budget.pixels:
            raise ConfigurationError(
                f"'{name}' of {self.where} has pictures of {width} x {height}, and {self.budget.pixels:,} pixels are "
                "allowed: raise ReadBudget.pixels (--read-pixels) if you trust it"
            )


def check_name(name: str, where: str) -> None:
    """Refuse a name that cannot be printed or that is a path.

    Args:
        name: name of an array.
        where: name of the file for messages.

    Raises:
        ConfigurationError: the name is refused; the message shows it.
    """
    if not name.isprintable() or name in ("", ".", "..") or "/" in name or len(name) > _MOST_CHARACTERS:
        raise ConfigurationError(f"{where} holds {name[:60]!a}, which is no name of an array")
