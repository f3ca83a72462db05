"""Lock of a folder that one process writes into."""

from __future__ import annotations

import fcntl
import os
import platform
from pathlib import Path

from orbit_core.interfaces.errors import ConfigurationError

LOCK = ".lock"
"""Name of the file that holds the lock, and names its process."""


class FolderLock:
    """Holds a folder until it is released. The system releases what a process held that died.

    Raises:
        ConfigurationError: another process holds it; names that.
    """

    def __init__(self, folder: Path) -> None:
        # No link is followed: in a folder from elsewhere it could name any file, which would be emptied.
        self._file = os.fdopen(os.open(folder / LOCK, os.O_RDWR | os.O_CREAT | os.O_NOFOLLOW, 0o666), "r+")
        try:
            fcntl.flock(self._file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
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
