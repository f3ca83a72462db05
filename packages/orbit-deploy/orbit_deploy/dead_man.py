"""Dead-man key: the robot moves only while a person holds the space bar of this terminal."""

from __future__ import annotations

import os
import select
import sys
import time

from orbit_core.interfaces import ConfigurationError, OrbitError

# Seconds that the key counts as held after its first character, as a terminal repeats after half a second at first, and
# after the next ones, which come every 30 ms or so
_HELD, _REPEATED = 0.7, 0.25


class ReleasedError(OrbitError):
    """A dead-man key that was released while the robot moved."""


class DeadManKey:
    """Space bar of a terminal.

    Args:
        descriptor: file descriptor of the terminal; standard input if None.

    Raises:
        ConfigurationError: the file is no terminal.
    """

    def __init__(self, descriptor: int | None = None) -> None:
        self._file = sys.stdin.fileno() if descriptor is None else descriptor
        if not os.isatty(self._file):
            raise ConfigurationError("a dead-man key is read from a terminal, and standard input is none")
        import termios
        import tty

        self._restore = termios.tcsetattr, (self._file, termios.TCSADRAIN, termios.tcgetattr(self._file))
        tty.setcbreak(self._file)  # characters without waiting for a line; Ctrl-C still interrupts
        # Released until the first press.
        self._until = 0.0

    @property
    def held(self) -> bool:
        """True while the key is held.

        Raises:
            ReleasedError: the terminal is closed.
        """
        while select.select([self._file], [], [], 0.0)[0]:
            try:
                typed = os.read(self._file, 1024)
            except OSError:
                typed = b""
            # The terminal is closed, and would be ready to be read for good.
            if not typed:
                raise ReleasedError("the terminal of the dead-man key is closed: the robot stops")
            if b" " in typed:
                now = time.monotonic()
                self._until = now + (_REPEATED if now < self._until else _HELD)
        return time.monotonic() < self._until

    def check(self) -> None:
        """Raise if the key is not held.

        Raises:
            ReleasedError: it is not.
        """
        if not self.held:
            raise ReleasedError("the dead-man key was released: the robot stops; hold it and start again")

    def wait(self) -> None:
        """Wait until the key is held."""
        while not self.held:
            time.sleep(0.02)

    def close(self) -> None:
        """Give the terminal back as it was."""
        function, arguments = self._restore
        function(*arguments)
