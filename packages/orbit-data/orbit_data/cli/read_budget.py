"""Options of the commands that read datasets and recordings, which may come from untrusted sources."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from orbit_data.reading.budget import ReadBudget


@dataclass(frozen=True, kw_only=True)
class ReadSettings:
    """Limits of the memory and time for reading data files."""

    read_bytes: int = 2**30
    """Limit of the bytes of an episode's arrays, or of a recording, once unpacked; raise it for data that you trust."""
    read_pixels: int = 2**24
    """Limit of the pixels of a video's picture."""
    read_seconds: float = 10.0
    """Longest time that opening a dataset, or reading an episode or a recording, may take."""

    @property
    def budget(self) -> ReadBudget:
        """Limits as readers take them."""
        from orbit_data.reading.budget import ReadBudget

        return ReadBudget(self.read_bytes, self.read_pixels, self.read_seconds)
