"""Devices by name: keyboard, gamepad and SpaceMouse of this computer, and devices of other modules.

The keyboard is read as characters of the terminal, so that it works over ssh and without a screen. The gamepad has the
order of axes and buttons that SDL gives an Xbox controller on Linux. A SpaceMouse of 3Dconnexion is read by its HID
reports, those of the SpaceNavigator's family: number 1 holds three translations as little-endian int16, followed by
three rotations on newer models; number 2 only the rotations; number 3 the buttons as bits. Full deflection is about 350
counts. The device's axes point right, towards the person, and down.
"""

from __future__ import annotations

import importlib
import os
import re
import select
import struct
import sys
import time
from collections.abc import Callable, Iterable
from typing import Any

from orbit_core.installing import install_extra
from orbit_core.interfaces import ConfigurationError, UnknownNameError
from orbit_data.teleoperation.device import Device, DeviceLostError, Event, Reading, Speeds
from orbit_data.teleoperation.driver import Driver

HAND = {
    "w": (0, 1.0), "s": (0, -1.0), "a": (1, 1.0), "d": (1, -1.0), "q": (2, 1.0), "e": (2, -1.0),
    "u": (3, 1.0), "o": (3, -1.0), "i": (4, 1.0), "k": (4, -1.0), "j": (5, 1.0), "l": (5, -1.0),
}  # fmt: skip
"""Keys that move the hand along and about x, y and z of the world."""
BASE = {
    "\x1b[A": (0, 1.0), "\x1b[B": (0, -1.0), "\x1b[D": (2, 1.0), "\x1b[C": (2, -1.0), ",": (1, 1.0), ".": (1, -1.0),
}  # fmt: skip
"""Keys that move a base: arrows forward, back and turning, comma and full stop to the left and right."""
KEY_EVENTS = {
    " ": Event.GRIPPER, "r": Event.RECORD, "v": Event.SAVE, "x": Event.DISCARD, "z": Event.RESET, "m": Event.SUCCESS,
    "n": Event.NEXT,
}  # fmt: skip
# Seconds that a key counts as held after its last character: longer than the period of a terminal's repetition, of
# some 30 a second.
_HELD = 0.15
_KEY = re.compile(r"\x1b\[[A-D]|.", re.DOTALL)


class Keyboard(Device):
    """Keys of :data:`HAND`, :data:`BASE` and :data:`KEY_EVENTS`, typed into a terminal.

    Args:
        speeds: speeds of the hand.
        descriptor: file descriptor of the terminal; standard input if None.

    Raises:
        ConfigurationError: the file is not a terminal.
    """

    def __init__(self, speeds: Speeds, descriptor: int | None = None) -> None:
        self._speeds = speeds
        self._file = sys.stdin.fileno() if descriptor is None else descriptor
        try:
            import termios
            import tty
        except ImportError:
            raise ConfigurationError("the keyboard is read from a POSIX terminal: use --device browser here") from None
        if not os.isatty(self._file):
            raise ConfigurationError("the keyboard is read from a terminal, and standard input is not one: use another "
                                     "--device, such as browser")  # fmt: skip
        self._restore = termios.tcsetattr, (self._file, termios.TCSADRAIN, termios.tcgetattr(self._file))
        tty.setcbreak(self._file)  # characters without waiting for a line; Ctrl-C still interrupts
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
            events=tuple(KEY_EVENTS[key] for key in typed if key in KEY_EVENTS),
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


_LEFT_X, _LEFT_Y, _LEFT_TRIGGER, _RIGHT_X, _RIGHT_Y, _RIGHT_TRIGGER = range(6)
_A, _B, _X, _Y, _LEFT_BUMPER, _RIGHT_BUMPER, _BACK, _START, _, _LEFT_STICK, _RIGHT_STICK = range(11)
GAMEPAD_EVENTS = {
    _A: Event.GRIPPER, _B: Event.DISCARD, _X: Event.RESET, _Y: Event.SUCCESS, _BACK: Event.SAVE, _START: Event.RECORD,
    _LEFT_STICK: Event.NEXT,
}  # fmt: skip
# Deflection of a stick that counts as none.
_DEAD = 0.1


class Gamepad(Device):
    """Gamepad: the left stick moves the hand over the plane, the triggers up and down, the right stick turns it.

    The right trigger is up. While the right bumper is held, the sticks drive the base: forward and left, and turning.
    The left bumper rolls the hand instead of pitching it.

    Args:
        speeds: speeds of the hand.
        events: returns events since its last call: pygame's, of which ``type`` and either ``axis`` and ``value`` or
            ``button`` are read; :func:`open_gamepad` passes those of a real gamepad.
        types: numbers of pygame's events for axes, pressed buttons, released buttons, and removed gamepads.
    """

    def __init__(self, speeds: Speeds, events: Callable[[], Iterable[Any]], types: tuple[int, int, int, int]) -> None:
        self._speeds, self._events, self._types = speeds, events, types
        # SDL reports -1 for a trigger that is not pressed.
        self._axes = dict.fromkeys(range(6), 0.0) | {_LEFT_TRIGGER: -1.0, _RIGHT_TRIGGER: -1.0}
        self._pressed: set[int] = set()

    def read(self) -> Reading:
        asked: list[Event] = []
        moved = False
        moving, down, up, gone = self._types
        for event in self._events():
            moved = True
            if event.type == gone:
                raise DeviceLostError("the gamepad was unplugged")
            if event.type == moving:
                self._axes[event.axis] = event.value
            elif event.type == down:
                self._pressed.add(event.button)
                asked += [GAMEPAD_EVENTS[event.button]] if event.button in GAMEPAD_EVENTS else []
            elif event.type == up:
                self._pressed.discard(event.button)
        left, right = (self._stick(_LEFT_X, _LEFT_Y), self._stick(_RIGHT_X, _RIGHT_Y))
        lift = 0.5 * (self._axes[_RIGHT_TRIGGER] - self._axes[_LEFT_TRIGGER])
        rolls = _LEFT_BUMPER in self._pressed
        turned = (right[0], 0.0, 0.0) if rolls else (0.0, -right[0], right[1])
        shares, base = (*left, lift, *turned), (0.0, 0.0, 0.0)
        if _RIGHT_BUMPER in self._pressed:
            shares, base = (0.0, 0.0, lift, 0.0, 0.0, 0.0), (*left, right[1])
        return Reading(self._speeds.twist(shares), base=base, events=tuple(asked), moved_at=_now_if(moved))

    def _stick(self, x: int, y: int) -> tuple[float, float]:
        """Return (forward, left) of a stick, whose own axes point right and back."""
        values = (-self._axes[y], -self._axes[x])
        return (values[0] if abs(values[0]) > _DEAD else 0.0, values[1] if abs(values[1]) > _DEAD else 0.0)


def open_gamepad(speeds: Speeds) -> Gamepad:
    """Return the first gamepad of this computer.

    Raises:
        ConfigurationError: no gamepad was found, or pygame is not installed.
    """
    os.environ.setdefault("SDL_VIDEODRIVER", "dummy")  # events need a video driver, not a screen
    os.environ.setdefault("PYGAME_HIDE_SUPPORT_PROMPT", "1")
    os.environ.setdefault("SDL_JOYSTICK_ALLOW_BACKGROUND_EVENTS", "1")
    try:
        pygame: Any = importlib.import_module("pygame")
    except ImportError:
        raise ConfigurationError(f"a gamepad needs pygame-ce: {install_extra('teleoperation')}") from None
    pygame.display.init()
    pygame.joystick.init()
    if not pygame.joystick.get_count():
        raise ConfigurationError("no gamepad was found: plug one in, or use another --device, such as browser")
    pad = pygame.joystick.Joystick(0)
    types = (pygame.JOYAXISMOTION, pygame.JOYBUTTONDOWN, pygame.JOYBUTTONUP, pygame.JOYDEVICEREMOVED)
    number = pad.get_instance_id()
    return Gamepad(speeds, lambda: [e for e in pygame.event.get(types) if e.instance_id == number], types)


def _now_if(moved: bool) -> float | None:
    return time.perf_counter() if moved else None


_COUNTS = 350.0
_MOUSE_DEAD = 0.05
# Products by maker: those that Logitech sold, and those of 3Dconnexion.
_MAKERS = {0x046D: range(0xC603, 0xC62C), 0x256F: range(0xC62C, 0xC670)}
# In the order of the device's buttons; the left one is the first. Most models have two.
_BUTTONS = (Event.GRIPPER, Event.RECORD, Event.SAVE, Event.DISCARD, Event.RESET, Event.SUCCESS, Event.NEXT)


class SpaceMouse(Device):
    """SpaceMouse, whose cap moves and turns the hand the same way, seen from behind the robot.

    Args:
        speeds: speeds of the hand.
        report: returns the next waiting report, its number first; empty if there is none. Raises OSError if the device
            has disappeared.
        release: releases the device.
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
        x, y, z, about_x, about_y, about_z = (0.0 if abs(value) < _MOUSE_DEAD else value for value in self._axes)
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
        ConfigurationError: no SpaceMouse was found, the user must not open it, or hidapi is not installed.
    """
    try:
        hid: Any = importlib.import_module("hid")
    except ImportError:
        raise ConfigurationError(f"a SpaceMouse needs hidapi: {install_extra('teleoperation')}") from None
    found = [each for each in hid.enumerate() if each["product_id"] in _MAKERS.get(each["vendor_id"], ())]
    if not found:
        raise ConfigurationError("no SpaceMouse was found: plug one in, or use another --device, such as browser")
    device = hid.device()
    try:
        device.open_path(found[0]["path"])
    except OSError as error:
        raise ConfigurationError(
            f"the SpaceMouse at {found[0]['path'].decode()} cannot be opened ({error}): give this user the permission "
            "to read it (a udev rule for hidraw)"
        ) from None
    device.set_nonblocking(True)
    return SpaceMouse(speeds, lambda: bytes(device.read(64)), device.close)


def _browser(speeds: Speeds, driver: Driver, port: int) -> Device:
    try:
        from orbit_data.teleoperation.browser import Browser
    except ImportError:
        raise ConfigurationError(f"the browser needs viser: {install_extra('viewer')}") from None
    return Browser(speeds, driver)


def _keyboard(speeds: Speeds, driver: Driver, port: int) -> Device:
    return Keyboard(speeds)


def _gamepad(speeds: Speeds, driver: Driver, port: int) -> Device:
    return open_gamepad(speeds)


def _spacemouse(speeds: Speeds, driver: Driver, port: int) -> Device:
    return open_spacemouse(speeds)


def _leader(speeds: Speeds, driver: Driver, port: int) -> Device:
    from orbit_data.teleoperation.leader import Leader

    if driver.hand is None:
        raise ConfigurationError(f"robot '{driver.active}' has no arm that a leader's joint values could move")
    return Leader(driver.hand.robot.joint_names, port)


DEVICES: dict[str, Callable[[Speeds, Driver, int], Device]] = {
    "browser": _browser,
    "keyboard": _keyboard,
    "gamepad": _gamepad,
    "spacemouse": _spacemouse,
    "leader": _leader,
}


def check_device(name: str) -> None:
    """Refuse an unknown name of a device.

    Raises:
        UnknownNameError: no device has the name; the message gives the nearest.
    """
    if name not in DEVICES:
        raise UnknownNameError("device", name, DEVICES)


def open_device(name: str, speeds: Speeds, driver: Driver, leader_port: int) -> Device:
    """Open a device.

    Args:
        name: name of the device, of :data:`DEVICES`.
        speeds: speeds of the hand at full deflection.
        driver: driver of the robots.
        leader_port: port that a leader arm sends to.

    Raises:
        UnknownNameError: no device has the name.
        ConfigurationError: the device is not plugged in, or the package that reads it is not installed.
    """
    check_device(name)
    return DEVICES[name](speeds, driver, leader_port)
