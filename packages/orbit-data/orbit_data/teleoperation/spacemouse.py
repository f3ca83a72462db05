"""A SpaceMouse of 3Dconnexion, by its HID reports.

Reports are those that the SpaceNavigator's family sends: number 1 holds three translations as little-endian int16, with
three rotations behind them on newer models; number 2 the rotations alone; number 3 the buttons as bits. Full deflection
is about 350 counts. The device's axes point right, towards the person, and down.
"""

from __future__ import annotations

import importlib
import struct
import time
from collections.abc import Callable
from typing import Any

from orbit_core.installing import install_extra
from orbit_core.interfaces import ConfigurationError
from orbit_data.teleoperation.device import Device, DeviceLostError, Event, Reading, Speeds

_COUNTS = 350.0
_DEAD = 0.05
# Products by maker: those that Logitech sold, and those of 3Dconnexion.
_MAKERS = {0x046D: range(0xC603, 0xC62C), 0x256F: range(0xC62C, 0xC670)}
# In the order of the device's buttons; the left one is the first. Most models have two.
_BUTTONS = (Event.GRIPPER, Event.RECORD, Event.SAVE, Event.DISCARD, Event.RESET, Event.SUCCESS, Event.NEXT)


class SpaceMouse(Device):
    """The cap moves and turns the hand as it is moved and turned itself, seen from behind the robot.

    Args:
        speeds: of the hand.
        report: the next report that waits, its number first; empty if none does. Raises OSError where the device is
            gone.
        release: gives the device back.
    """

    def __init__(self, speeds: Speeds, report: Callable[[], bytes], release: Callable[[], None] = lambda: None) -> None:
        self._speeds, self._report, self._release = speeds, report, release
        self._axes = [0.0] * 6
        self._pressed = 0

    def read(self) -> Reading:
        asked: list[Event] = []
        moved = False
        try:
            while report := self._report():
                moved = True
                self._take(report, asked)
        except (OSError, ValueError) as error:
            raise DeviceLostError(f"the SpaceMouse was unplugged: {error}") from None
        x, y, z, about_x, about_y, about_z = (0.0 if abs(value) < _DEAD else value for value in self._axes)
        twist = self._speeds.twist((-y, -x, -z, -about_y, -about_x, -about_z))
        return Reading(twist, events=tuple(asked), moved_at=time.perf_counter() if moved else None)

    def close(self) -> None:
        self._release()

    def _take(self, report: bytes, asked: list[Event]) -> None:
        number, body = report[0], report[1:]
        if number in (1, 2) and len(body) >= 6:
            count = 6 if number == 1 and len(body) >= 12 else 3
            counts = struct.unpack(f"<{count}h", body[: 2 * count])
            first = 3 * (number - 1)
            self._axes[first : first + count] = [max(-1.0, min(1.0, value / _COUNTS)) for value in counts]
        elif number == 3 and body:
            pressed = int.from_bytes(body, "little")
            new = pressed & ~self._pressed
            asked += [event for place, event in enumerate(_BUTTONS) if new >> place & 1]
            self._pressed = pressed


def open_spacemouse(speeds: Speeds) -> SpaceMouse:
    """Return the first SpaceMouse of this computer.

    Raises:
        ConfigurationError: there is none that this user may open, or hidapi is not installed.
    """
    try:
        hid: Any = importlib.import_module("hid")
    except ImportError:
        raise ConfigurationError(f"a SpaceMouse needs hidapi: {install_extra('teleoperation')}") from None
    found = [each for each in hid.enumerate() if each["product_id"] in _MAKERS.get(each["vendor_id"], ())]
    if not found:
        raise ConfigurationError("there is no SpaceMouse: plug one in, or take another --device, such as browser")
    device = hid.device()
    try:
        device.open_path(found[0]["path"])
    except OSError as error:
        raise ConfigurationError(
            f"the SpaceMouse at {found[0]['path'].decode()} cannot be opened ({error}): give this user the right to "
            "read it (a udev rule for hidraw)"
        ) from None
    device.set_nonblocking(True)
    return SpaceMouse(speeds, lambda: bytes(device.read(64)), device.close)
