"""Progress of a long build on stderr: how far it is, what remains, and the memory that it takes."""

from __future__ import annotations

import sys
import time

# Seconds between two lines, and before the first.
_SILENT_FOR = 10.0


class BuildProgress:
    """Counts environments that have been built."""

    def __init__(self, total: int, memory: float) -> None:
        """``memory`` in bytes, of all environments together."""
        self._total = total
        self._memory = memory
        self._built = self._first = 0
        self._began = self._told = 0.0

    def add(self, environments: int) -> None:
        """Count some more, and report if the last report is long ago; the first ones start the clock."""
        now = time.monotonic()
        if not self._built:
            self._built = self._first = environments
            self._began = self._told = now
            return
        self._built += environments
        if now - self._told < _SILENT_FOR or self._built == self._total:
            return
        self._told = now
        rest = (now - self._began) * (self._total - self._built) / (self._built - self._first)
        print(
            f"orbit-bullet: built {self._built} of {self._total} environments, {rest:.0f} s to go; "
            f"all of them will take {self._memory / 1e9:.1f} GB of memory",
            file=sys.stderr,
            flush=True,
        )
