"""Starting Warp without its remark that a machine has no GPU, which is no news to those who simulate on a CPU."""

from __future__ import annotations

import contextlib
import functools
import os
import sys
import tempfile
from collections.abc import Iterator

import warp as wp

_NO_DRIVER = "Could not find or load the NVIDIA CUDA driver"


@functools.cache
def start() -> None:
    """Initialise Warp so that it logs warnings, but not each module that it loads. A second call does nothing."""
    wp.config.log_level = wp.LOG_WARNING
    with _without_lines(_NO_DRIVER):
        wp.init()


@contextlib.contextmanager
def _without_lines(words: str) -> Iterator[None]:
    """Hold back what the process writes to standard error, and afterwards let pass the lines without ``words``.

    Warp's library writes that line from C, past Python's ``sys.stderr`` and regardless of its log level.
    """
    sys.stderr.flush()
    with tempfile.TemporaryFile() as held:
        original = os.dup(2)
        os.dup2(held.fileno(), 2)
        try:
            yield
        finally:
            os.dup2(original, 2)
            os.close(original)
            held.seek(0)
            for line in held.read().decode(errors="replace").splitlines(keepends=True):
                if words not in line:
                    sys.stderr.write(line)
