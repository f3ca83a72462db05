"""A request to end that comes from outside ends a command as the interrupt key does: everything is closed first."""

from __future__ import annotations

import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType
from typing import NoReturn


class Terminated(KeyboardInterrupt):
    """SIGTERM came. It passes wherever an interrupt passes."""


@contextmanager
def termination_interrupts() -> Iterator[None]:
    """Within, SIGTERM raises :class:`Terminated` in the main thread; elsewhere than there nothing is changed."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    before = signal.signal(signal.SIGTERM, _terminate)
    try:
        yield
    finally:
        signal.signal(signal.SIGTERM, before)


def _terminate(number: int, frame: FrameType | None) -> NoReturn:
    signal.signal(number, signal.SIG_IGN)  # a second one must not cut the cleaning up short
    raise Terminated
