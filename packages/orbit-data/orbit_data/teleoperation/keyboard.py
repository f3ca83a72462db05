"""A keyboard, by the terminal's own characters: it works over ssh as well, and needs no screen."""

from __future__ import annotations

import os
import re
import select
import sys
import time

from orbit_core.interfaces import ConfigurationError
from orbit_data.teleoperation.device import Device, DeviceLostError, Event, Reading, Speeds

HAND = {
    "w": (0, 1.0), "s": (0, -1.0), "a": (1, 1.0), "d": (1, -1.0), "q": (2, 1.0), "e": (2, -1.0),
    "u": (3, 1.0), "o": (3, -1.0), "i": (4, 1.0), "k": (4, -1.0), "j": (5, 1.0), "l": (5, -1.0),
}  # fmt: skip
"""Keys that move the hand along and about x, y and z of the world."""
BASE = {
    "\x1b[A": (0, 1.0), "\x1b[B": (0, -1.0), "\x1b[D": (2, 1.0), "\x1b[C": (2, -1.0), ",": (1, 1.0), ".": (1, -1.0),
}  # fmt: skip
"""Keys that move a base: arrows forward, back and turning, comma and full stop to the left and right."""
EVENTS = {
    " ": Event.GRIPPER, "r": Event.RECORD, "v": Event.SAVE, "x": Event.DISCARD, "z": Event.RESET, "m": Event.SUCCESS,
    "n": Event.NEXT,
}  # fmt: skip
# s that a key counts as held after its last character: longer than a terminal's repetition, of some 30 a second.
_HELD = 0.15
_KEY = re.compile(r"\x1b\[[A-D]|.", re.DOTALL)


class Keyboard(Device):
    """Keys of :data:`HAND`, :data:`BASE` and :data:`EVENTS`, typed into a terminal.

    Args:
        speeds: of the hand.
        descriptor: of the terminal; standard input if None.

    Raises:
        ConfigurationError: it is no terminal.
    """

    def __init__(self, speeds: Speeds, descriptor: int | None = None) -> None:
        self._speeds = speeds
        self._file = sys.stdin.fileno() if descriptor is None else descriptor
        try:
            import termios
            import tty
        except ImportError:
            raise ConfigurationError("the keyboard is read from a POSIX terminal: take --device browser here") from None
        if not os.isatty(self._file):
            raise ConfigurationError("the keyboard is read from a terminal, and standard input is none: take another "
                                     "--device, such as browser")  # fmt: skip
        self._restore = termios.tcsetattr, (self._file, termios.TCSADRAIN, termios.tcgetattr(self._file))
        tty.setcbreak(self._file)
        self._held: dict[str, float] = {}

    def read(self) -> Reading:
        now = time.perf_counter()
        typed = _KEY.findall(self._characters())
        self._held |= dict.fromkeys((key for key in typed if key in HAND or key in BASE), now)
        hand, base = [0.0] * 6, [0.0] * 3
        for key, last in self._held.items():
            if now - last < _HELD:
                axes, (axis, sign) = (hand, HAND[key]) if key in HAND else (base, BASE[key])
                axes[axis] += sign
        return Reading(
            twist=self._speeds.twist(hand),
            base=(base[0], base[1], base[2]),
            events=tuple(EVENTS[key] for key in typed if key in EVENTS),
            moved_at=now if typed else None,
        )

    def close(self) -> None:
        function, arguments = self._restore
        function(*arguments)

    def _characters(self) -> str:
        data = b""
        try:
            while select.select([self._file], [], [], 0.0)[0]:
                more = os.read(self._file, 1024)
                if not more:
                    raise DeviceLostError("the keyboard's terminal was closed")
                data += more
        except OSError as error:
            raise DeviceLostError(f"the keyboard's terminal is gone: {error}") from None
        return data.decode(errors="ignore")
