"""Files and folders that appear whole or not at all, and folders with a single writer.

A writer writes to its own folder next to the target. The result takes the target's place in one step, once it is
complete and flushed to the disk: however the program ends, the target is the old one or the new one.
"""

from __future__ import annotations

import ctypes
import errno
import fcntl
import os
import re
import secrets
import shutil
from collections.abc import Iterable, Iterator
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


DISK_FULL = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)
"""Numbers of the errors by which a system says that there is no room."""
# Names of the folders that things are written in
_PARTIAL = re.compile(r"\.orbit-[0-9a-f]{8}\.partial")
# Folder within such a folder that holds what is being replaced, where two names cannot be exchanged at once
_REPLACED = "replaced"
# RENAME_EXCHANGE and AT_FDCWD of Linux's renameat2
_EXCHANGE, _HERE = 2, -100


class Replacement:
    """A file or folder in the making, which takes the place of another once it is whole.

    Each writer has its own, so that several processes may write the same target.

    Args:
        path: of the target, which need not be there.

    Raises:
        StorageError: the disk is full, or the folder around it cannot be written; names the target.
    """

    def __init__(self, path: Path) -> None:
        # A path that ends in ".." has no name that a folder could take.
        self.path = path if path.name not in ("", "..") else path.resolve()
        with storage_faults(path):
            self._folder, self._lock = _locked_folder(self.path.parent)
        self.written = self._folder / self.path.name
        """Path to write to, of the target's name."""

    def take_place(self) -> None:
        """Flush what was written to the disk, and let it take the target's place.

        Raises:
            StorageError: it cannot; the target stays as it was.
        """
        try:
            with storage_faults(self.path):
                for path in (self.written, *self.written.rglob("*")):
                    _to_disk(path)
                _take_place(self.written, self.path)
                _to_disk(self.path.parent)
        finally:
            self.discard()

    def discard(self) -> None:
        """Delete what was written, or what it replaced; idempotent."""
        if self._lock is not None:
            shutil.rmtree(self._folder, ignore_errors=True)
            os.close(self._lock)
            self._lock = None


@contextmanager
def written_whole(path: Path) -> Iterator[Path]:
    """Yield a new path to write a file or a folder to, which takes the place of ``path`` at the end.

    Where anything goes wrong, what was written is deleted and ``path`` stays as it was.

    Raises:
        StorageError: the disk is full, or the folder cannot be written; names the target.
    """
    replacement = Replacement(path)
    try:
        with storage_faults(path):
            yield replacement.written
        replacement.take_place()
    except StorageError as error:  # of a file within, which the user knows by its later name
        raise StorageError(str(error).replace(str(replacement.written), str(path))) from error
    finally:
        replacement.discard()


def append_line(path: Path, line: str) -> None:
    """Append a whole line to a file and flush it to the disk; on an error the file stays as it was.

    Raises:
        StorageError: the disk is full, or the file cannot be written.
    """
    with storage_faults(path), path.open("ab", buffering=0) as file:
        whole = os.fstat(file.fileno()).st_size
        rest = memoryview(line.encode() + b"\n")
        try:
            while rest:
                rest = rest[file.write(rest) :]
            os.fsync(file.fileno())
        except OSError:
            file.truncate(whole)
            raise


def sweep(folder: Path) -> None:
    """Delete partial results of dead writers in a folder, and restore what they were about to replace."""
    for left in folder.glob(".orbit-*.partial"):
        if not _PARTIAL.fullmatch(left.name) or left.is_symlink():
            continue
        with suppress(OSError):
            lock = os.open(left, os.O_RDONLY | os.O_DIRECTORY)
            try:
                fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)  # fails while its writer lives
                for old in left.glob(f"{_REPLACED}/*"):
                    if not (folder / old.name).exists():
                        old.rename(folder / old.name)
                shutil.rmtree(left)
            finally:
                os.close(lock)


def check_apart(output: Path, inputs: Iterable[Path]) -> None:
    """Reject an output that would destroy what is read, or the folder that the program runs in.

    Args:
        output: file or folder to write.
        inputs: files and folders that are read.

    Raises:
        ConfigurationError: the output is, holds or is in an input, or is or holds the working folder.
    """
    target = output.resolve()
    for path in inputs:
        source = path.resolve()
        if target == source:
            raise ConfigurationError(f"{output} is what is read: give another name")
        if source.is_relative_to(target):
            raise ConfigurationError(f"{output} holds {path}, which is read: give another name")
        if target.is_relative_to(source):
            raise ConfigurationError(f"{output} is in {path}, which is read: give another name")
    if Path.cwd().is_relative_to(target):
        raise ConfigurationError(f"{output} is the working folder, or holds it: give another name")


@contextmanager
def storage_faults(path: Path) -> Iterator[None]:
    """Turn errors of the file system into one sentence that names the file and the reason.

    Raises:
        StorageError: an operation on files failed.
    """
    try:
        yield
    except OSError as error:
        reason = error.strerror or str(error).strip().partition("\n")[0]
        raise StorageError(f"cannot write {path}: {reason}") from error


def _locked_folder(parent: Path) -> tuple[Path, int]:
    """Make a folder to write in, with a lock by which :func:`sweep` knows that its writer is alive."""
    while True:
        folder = parent / f".orbit-{secrets.token_hex(4)}.partial"
        folder.mkdir()
        with suppress(FileNotFoundError):
            lock = os.open(folder, os.O_RDONLY | os.O_DIRECTORY)
            with suppress(OSError):  # some network file systems have no locks; nothing is swept there
                fcntl.flock(lock, fcntl.LOCK_EX)
            if folder.exists():
                return folder, lock
            os.close(lock)  # another process swept it before it was locked


def _take_place(written: Path, path: Path) -> None:
    """Give what was written the target's name; a folder that was there is left where the new one was written."""
    if not (written.is_dir() and path.is_dir() and not path.is_symlink()):
        written.replace(path)
    elif not _exchange(written, path):
        old = written.parent / _REPLACED / path.name
        old.parent.mkdir()
        path.rename(old)
        try:
            written.rename(path)
        except OSError:
            old.rename(path)
            raise


def _exchange(first: Path, second: Path) -> bool:
    """Exchange two names in one step; return False where the system or the file system cannot."""
    rename = getattr(ctypes.CDLL(None), "renameat2", None)
    return rename is not None and rename(_HERE, os.fsencode(first), _HERE, os.fsencode(second), _EXCHANGE) == 0


def _to_disk(path: Path) -> None:
    """Make what was written outlast a loss of power."""
    handle = os.open(path, os.O_RDONLY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)
