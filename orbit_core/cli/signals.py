"""Requests to end that come from outside: the first one closes everything, a second one ends the process at once."""

from __future__ import annotations

import _thread
import ctypes
import signal
import sys
import threading
from types import FrameType
from typing import Any

_NUMBERS = (signal.SIGTERM, signal.SIGINT)
# s from one raise of the exception to the next, where something has swallowed it
_PATIENCE = 1.0
# What ``signal.signal`` takes and returns
_Handler = Any


class Terminated(KeyboardInterrupt):
    """SIGTERM came. It is raised as an interrupt is."""


class EndRequest:
    """The request to end that a command is given, heard within a ``with`` of the main thread; others change nothing.

    SIGTERM raises :class:`Terminated` and the interrupt key KeyboardInterrupt. Libraries swallow exceptions, be it by
    an ``except`` for all kinds or in a finalizer: where that happens, the exception is raised again a second later.
    From the first request on the system handles both signals, so that a second one ends the process in any case.
    """

    exit_code: int | None = None
    """128 and the signal's number, as shells report it; None while nobody has asked."""

    def __init__(self) -> None:
        self._before: dict[int, _Handler] = {}
        self._over = threading.Event()

    def __enter__(self) -> EndRequest:
        if threading.current_thread() is threading.main_thread():
            # A shell starts what runs in the background with the interrupt key ignored, and so it stays.
            heard = [number for number in _NUMBERS if signal.getsignal(number) != signal.SIG_IGN]
            self._before = {number: signal.signal(number, self._end) for number in {signal.SIGTERM, *heard}}
            for number in self._before:
                _hear_once(number)
        return self

    def __exit__(self, *error: object) -> None:
        self._over.set()
        for number, handler in self._before.items():
            signal.signal(number, signal.SIG_DFL if handler is None else handler)

    def _end(self, number: int, frame: FrameType | None) -> None:
        if self._over.is_set() or _interrupt_is_handled():
            return
        if self.exit_code is None:
            self.exit_code = 128 + number
            for each in self._before:
                _set_system_handling(each)
            threading.Thread(target=self._insist, args=(number,), daemon=True).start()
        raise Terminated if number == signal.SIGTERM else KeyboardInterrupt

    def _insist(self, number: int) -> None:
        while not self._over.wait(_PATIENCE):
            _thread.interrupt_main(signal.Signals(number))  # calls the handler in the main thread; no signal is sent


def _interrupt_is_handled() -> bool:
    """Return True if the code that was interrupted runs because of an interrupt: it cleans up, and is left alone."""
    error = sys.exc_info()[1]
    while error is not None and not isinstance(error, KeyboardInterrupt):
        error = error.__context__
    return error is not None


def _hear_once(number: int) -> None:
    """Have the system put back its own handling when it calls the handler of a signal.

    Python runs handlers between its own instructions only. A process that is stuck in native code never gets there, and
    a second signal must end it too. Systems other than those with the GNU C library do without.
    """
    if _sysv_signal is not None:
        _sysv_signal(number, _sysv_signal(number, None))


def _set_system_handling(number: int) -> None:
    """Have the system handle a signal, if possible without Python's knowledge: ``interrupt_main`` needs a handler."""
    if _sysv_signal is not None:
        _sysv_signal(number, None)
    else:
        signal.signal(number, signal.SIG_DFL)


def _native() -> Any:
    call = getattr(ctypes.CDLL(None), "sysv_signal", None)
    if call is not None:
        call.restype, call.argtypes = ctypes.c_void_p, (ctypes.c_int, ctypes.c_void_p)
    return call


# Installs a handler of a signal for one call; the GNU C library has it
_sysv_signal = _native()
