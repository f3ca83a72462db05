"""Bullet itself: imported late, without its greetings on the terminal, one client a connection."""

from __future__ import annotations

import contextlib
import ctypes
import functools
import importlib
import os
import sys
import threading
from collections.abc import Iterator
from typing import Any

from orbit_core.interfaces import BackendNotInstalledError, OrbitError

LAST_PYTHON = (3, 11)
"""The newest for which pybullet has wheels."""


@functools.cache
def bullet() -> Any:
    """The module ``pybullet``.

    Raises:
        BackendNotInstalledError: it is not installed; says what to install on this Python.
    """
    try:
        with silence():
            return importlib.import_module("pybullet")
    except ModuleNotFoundError as error:
        if error.name != "pybullet":
            raise
        if sys.version_info[:2] > LAST_PYTHON:
            found = ".".join(map(str, sys.version_info[:2]))
            remedy = f"pybullet has wheels up to Python 3.11 and this is {found}: pip install pybullet-arm64, a fork"
        else:
            remedy = "pip install pybullet"
        raise BackendNotInstalledError(f"backend 'bullet' needs the module pybullet, which is missing: {remedy}") from (
            error
        )


class Client:
    """Separate connection: every function and constant of the module, bound to it."""

    def __init__(self) -> None:
        self._module = bullet()
        with silence():
            self._number = self._module.connect(self._module.DIRECT)

    def __getattr__(self, name: str) -> Any:
        value = getattr(self._module, name)
        if callable(value):
            value = functools.partial(value, physicsClientId=self._number)
        setattr(self, name, value)
        return value

    def close(self) -> None:
        """Disconnect; idempotent."""
        if self._number >= 0:
            self._module.disconnect(physicsClientId=self._number)
            self._number = -1


@contextlib.contextmanager
def refusals(what: str, kind: type[OrbitError]) -> Iterator[None]:
    """Raise Bullet's own errors, which name neither culprit nor cause, as one of ``kind`` that says ``what`` failed."""
    try:
        yield
    except bullet().error as error:
        raise kind(f"{what}: {error}") from error


# Held while the terminal is away: two threads that interleave would leave the process without it for good.
_silencing = threading.RLock()


@contextlib.contextmanager
def silence() -> Iterator[None]:
    """Keep what the C++ code prints away from the terminal; one thread at a time, the others wait."""
    with _silencing, _without_terminal():
        yield


@contextlib.contextmanager
def _without_terminal() -> Iterator[None]:
    sys.stdout.flush()
    sys.stderr.flush()
    flush = ctypes.CDLL(None).fflush if os.name == "posix" else lambda _: None
    flush(None)
    kept = {stream: os.dup(stream) for stream in (1, 2)}
    nothing = os.open(os.devnull, os.O_WRONLY)
    try:
        for stream in kept:
            os.dup2(nothing, stream)
        yield
    finally:
        flush(None)
        for stream, copy in kept.items():
            os.dup2(copy, stream)
            os.close(copy)
        os.close(nothing)
