"""Files that a call opens or writes though it may not, seen by the kernel whichever library or process opens them."""

from __future__ import annotations

import ctypes
import os
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

_OPENED = 0x20
"""``IN_OPEN`` of Linux's inotify."""
_HEADER = 16
"""Bytes of an event for a file that is watched by itself."""


@contextmanager
def watched(paths: Sequence[Path]) -> Iterator[list[str]]:
    """Give a list that holds, once the block is left, those of the files that anyone opened in it."""
    libc = ctypes.CDLL(None, use_errno=True)
    handle = libc.inotify_init1(os.O_NONBLOCK)
    if handle < 0:
        raise OSError(ctypes.get_errno(), "inotify_init1")
    names = {libc.inotify_add_watch(handle, os.fsencode(path), _OPENED): str(path) for path in paths}
    opened: list[str] = []
    try:
        yield opened
        try:
            events = os.read(handle, 2**16)
        except BlockingIOError:
            events = b""
        numbers = {int.from_bytes(events[at : at + 4], "little") for at in range(0, len(events), _HEADER)}
        opened += sorted(names[number] for number in numbers)
    finally:
        os.close(handle)


def contents(folder: Path) -> dict[Path, tuple[int, int]]:
    """Return the size and time of the last change of every file below a folder."""
    return {path: (path.lstat().st_size, path.lstat().st_mtime_ns) for path in folder.rglob("*") if not path.is_dir()}
