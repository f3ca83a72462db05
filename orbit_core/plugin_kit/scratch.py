"""Temporary folders; those of a process that was killed are removed by the next one that makes a folder there."""

from __future__ import annotations

import fcntl
import os
import shutil
import tempfile
import weakref
from contextlib import suppress
from pathlib import Path
from typing import IO

PREFIX = "orbit-"
"""Begins the name of every such folder; others are not looked at."""
OWNER = ".owner"
"""File that the owner holds a lock on. The system releases it whatever ends the owner; a process number would be given
to another process, and means something else in another container."""


class ScratchFolder:
    """A temporary folder, which is removed by :meth:`remove`, at the end of a ``with`` or of the process.

    Args:
        prefix: of its name; begins with ``orbit-``.
        parent: folder that it is made in; that of the system's temporary files if None.
    """

    def __init__(self, prefix: str, parent: Path | None = None) -> None:
        parent = Path(tempfile.gettempdir()) if parent is None else parent
        assert prefix.startswith(PREFIX)
        sweep(parent)
        while True:
            self.path = Path(tempfile.mkdtemp(prefix=prefix, dir=parent))
            """Path of the folder."""
            lock = _lock(self.path, "x")
            if lock is not None:
                break  # else another process has swept it before it was locked
        self._finalizer = weakref.finalize(self, _remove, self.path, lock, os.getpid())

    def remove(self) -> None:
        """Remove the folder with all that is in it; idempotent."""
        self._finalizer()

    def __enter__(self) -> Path:
        return self.path

    def __exit__(self, *error: object) -> None:
        self.remove()


def sweep(parent: Path) -> None:
    """Remove the scratch folders in ``parent`` of this user's processes that have ended without doing so."""
    with suppress(OSError):
        for folder in parent.glob(f"{PREFIX}*"):
            with suppress(OSError):  # another process was faster, or it belongs to another user
                if folder.is_symlink() or folder.stat().st_uid != os.getuid():
                    continue
                lock = _lock(folder, "r+")
                if lock is not None:
                    shutil.rmtree(folder, ignore_errors=True)
                    lock.close()


def _lock(folder: Path, mode: str) -> IO[str] | None:
    """Take the lock of a folder; None if it is taken, or there is none."""
    owner = folder / OWNER
    try:
        file = owner.open(mode)
    except OSError:
        return None
    try:
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        if os.fstat(file.fileno()).st_ino == owner.stat().st_ino:
            return file
    except OSError:
        pass
    file.close()
    return None


def _remove(folder: Path, lock: IO[str], owner: int) -> None:
    if os.getpid() == owner:  # a process that was forked from it ends too, and this is not its own
        shutil.rmtree(folder, ignore_errors=True)
    lock.close()
