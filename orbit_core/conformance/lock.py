"""One run at a time in a folder."""

from __future__ import annotations

import fcntl
import os
import platform
from pathlib import Path

from orbit_core.interfaces import ConfigurationError

LOCK = ".lock"


class FolderLock:
    """Holds a folder until it is released. The system releases what a process held that died.

    Raises:
        ConfigurationError: another process holds it; names that.
    """

    def __init__(self, folder: Path) -> None:
        self._file = (folder / LOCK).open("a+")
        try:
            fcntl.flock(self._file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            self._file.seek(0)
            holder = self._file.read().strip()
            self._file.close()
            raise ConfigurationError(
                f"a run of process {holder} is writing into folder {folder}: wait for its end, or give another --output"
            ) from None
        self._file.truncate(0)
        self._file.write(f"{os.getpid()} on {platform.node()}\n")
        self._file.flush()

    def release(self) -> None:
        """Release the folder."""
        self._file.close()
