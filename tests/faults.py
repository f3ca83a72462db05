"""Faults that tests inject: a kill at a chosen moment of writing, and a disk that is full."""

from __future__ import annotations

import os
import resource
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

KILLS = 50 if os.environ.get("ORBIT_TEST_ALL") == "1" else 8
"""Moments at which tests kill a writer."""
_TOUCHED = ("open", "shutil.rmtree", "os.")
"""Events of Python's that come before a file system is read or changed begin so."""


def kills(folder: Path, work: Callable[[], object], prepare: Callable[[], object] = lambda: None) -> Iterator[int]:
    """Kill some work at moments spread over all that it does to the files of a folder; yield after each kill.

    Each time a forked process does the work and kills itself, as SIGKILL from outside would, right before it opens,
    makes, renames or deletes something in the folder. After the last kill the work is left to end.

    Args:
        folder: whose files count.
        work: touches no tensors, for it runs in a forked process.
        prepare: runs before each kill, here.
    """
    prepare()
    whole = _run(folder, work, 1 << 30)
    assert whole > 0
    for moment in sorted({round(1 + place * (whole - 1) / (KILLS - 1)) for place in range(KILLS)}):
        prepare()
        assert _run(folder, work, moment) == 0, f"the work did less than before: no moment {moment} of {whole}"
        yield moment


def _run(folder: Path, work: Callable[[], object], moment: int) -> int:
    """Do the work in a forked process that is killed at a moment; the number of moments if it ends before."""
    reader, writer = os.pipe()
    child = os.fork()
    if child == 0:
        count = 0

        def watch(event: str, arguments: tuple[object, ...]) -> None:
            nonlocal count
            touched = event.startswith(_TOUCHED) and any(own in str(argument) for argument in arguments)
            if not touched and not (event == "ctypes.dlsym" and arguments[1] == "renameat2"):
                return
            count += 1
            if count == moment:
                os.kill(os.getpid(), signal.SIGKILL)

        own = str(folder)
        try:
            sys.addaudithook(watch)
            work()
            os.write(writer, count.to_bytes(4, "little"))
        finally:
            os._exit(0)
    os.close(writer)
    with os.fdopen(reader, "rb") as pipe:
        told = pipe.read()
    status = os.waitpid(child, 0)[1]
    assert told or os.WIFSIGNALED(status), "the work failed in its process"
    return int.from_bytes(told, "little")


@contextmanager
def no_file_beyond(size: int) -> Iterator[None]:
    """Let no file grow beyond so many bytes, which the kernel refuses as it refuses to write to a full disk."""
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, before[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)


@contextmanager
def small_disk(folder: Path, size: int) -> Iterator[Path]:
    """A disk of so many bytes at a folder, where the user may mount one; skips the test elsewhere."""
    folder.mkdir()
    mount = ["mount", "-t", "tmpfs", "-o", f"size={size}", "tmpfs", str(folder)]
    if os.geteuid() != 0 or subprocess.run(mount, capture_output=True).returncode != 0:
        pytest.skip("the capability is mounting a small disk, which needs root")
    try:
        yield folder
    finally:
        subprocess.run(["umount", "--lazy", str(folder)], check=True)
