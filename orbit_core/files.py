"""Files that are whole or not there, whatever ends a program in the midst of writing, and folders of one writer."""

from __future__ import annotations

import fcntl
import os
import platform
import secrets
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from orbit_core.interfaces.errors import ArgumentError, ConfigurationError, StorageError

MAX_FILE = 2**30
"""Most bytes of a file that is read as a whole."""


def as_path(path: Path | str) -> Path:
    """Return a path that a caller gave as text or as a path.

    Raises:
        ArgumentError: it is of another type, empty text, or holds a null character.
    """
    if isinstance(path, str | os.PathLike) and isinstance(text := os.fspath(path), str) and text and "\0" not in text:
        return Path(path)
    raise ArgumentError(f"{path!r} is no path of a file or folder: give text or a pathlib.Path")


def read_bytes(path: Path | str, most: int = MAX_FILE) -> bytes:
    """Read all of a regular file.

    Args:
        path: of the file.
        most: bytes that it may have.

    Raises:
        ConfigurationError: there is no such file, it cannot be read, is no regular file, or larger.
    """
    path = as_path(path)
    if not path.exists():
        raise ConfigurationError(f"there is no file {path}")
    if not path.is_file():
        raise ConfigurationError(f"{path} is no regular file")
    try:
        with path.open("rb") as file:
            data = file.read(most + 1)
    except OSError as error:
        raise ConfigurationError(f"{path} cannot be read: {error.strerror}") from error
    if len(data) > most:
        raise ConfigurationError(f"{path} is larger than {most:,} bytes, the most that is read")
    return data


@contextmanager
def written_whole(path: Path) -> Iterator[Path]:
    """A new file beside ``path`` to write, which takes its place at the end, flushed to the disk.

    Each writer has its own, so that several processes may write the same file. It is removed where anything goes wrong.

    Raises:
        StorageError: the disk is full, or the folder cannot be written; names the file.
    """
    written = path.with_name(f".{path.stem}.{secrets.token_hex(4)}{path.suffix}")
    with storage_faults(path):
        try:
            yield written
            _to_disk(written)
            written.replace(path)
        except BaseException:
            with suppress(OSError):
                written.unlink(missing_ok=True)
            raise
        _to_disk(path.parent)


@contextmanager
def storage_faults(path: Path) -> Iterator[None]:
    """What the file system refuses within, as one sentence that names the file and the reason.

    Raises:
        StorageError: an operation on files failed.
    """
    try:
        yield
    except OSError as error:
        reason = error.strerror or str(error).strip().partition("\n")[0]
        raise StorageError(f"cannot write {path}: {reason}") from error


def _to_disk(path: Path) -> None:
    """Make what was written outlast a loss of power."""
    handle = os.open(path, os.O_RDONLY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)


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
