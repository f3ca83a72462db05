"""A gamepad, in the order of axes and buttons that SDL gives an Xbox controller on Linux."""

from __future__ import annotations

import importlib
import os
import time
from collections.abc import Callable, Iterable
from typing import Any

from orbit_core.installing import install_extra
from orbit_core.interfaces import ConfigurationError
from orbit_data.teleoperation.device import Device, DeviceLostError, Event, Reading, Speeds

_LEFT_X, _LEFT_Y, _LEFT_TRIGGER, _RIGHT_X, _RIGHT_Y, _RIGHT_TRIGGER = range(6)
_A, _B, _X, _Y, _LEFT_BUMPER, _RIGHT_BUMPER, _BACK, _START, _, _LEFT_STICK, _RIGHT_STICK = range(11)
EVENTS = {
    _A: Event.GRIPPER, _B: Event.DISCARD, _X: Event.RESET, _Y: Event.SUCCESS, _BACK: Event.SAVE, _START: Event.RECORD,
    _LEFT_STICK: Event.NEXT,
}  # fmt: skip
# Deflection of a stick that counts as none.
_DEAD = 0.1


class Gamepad(Device):
    """The left stick moves the hand over the plane, the triggers up (right) and down (left), the right stick turns it.

    With the right bumper held, the sticks drive the base: forward and left, and turning. The left bumper rolls the hand
    in place of pitching it.

    Args:
        speeds: of the hand.
        events: what happened since it was called last: events of pygame, of which ``type`` and either ``axis`` and
            ``value`` or ``button`` count; :func:`open_gamepad` has those of a real one.
        types: the numbers of pygame's events for axes, buttons pressed, buttons let go, and a pad that is gone.
    """

    def __init__(self, speeds: Speeds, events: Callable[[], Iterable[Any]], types: tuple[int, int, int, int]) -> None:
        self._speeds, self._events, self._types = speeds, events, types
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
                asked += [EVENTS[event.button]] if event.button in EVENTS else []
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
        """(forward, left) of a stick, whose own axes point right and back."""
        values = (-self._axes[y], -self._axes[x])
        return (values[0] if abs(values[0]) > _DEAD else 0.0, values[1] if abs(values[1]) > _DEAD else 0.0)


def open_gamepad(speeds: Speeds) -> Gamepad:
    """Return the first gamepad of this computer.

    Raises:
        ConfigurationError: there is none, or pygame is not installed.
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
        raise ConfigurationError("there is no gamepad: plug one in, or take another --device, such as browser")
    pad = pygame.joystick.Joystick(0)
    types = (pygame.JOYAXISMOTION, pygame.JOYBUTTONDOWN, pygame.JOYBUTTONUP, pygame.JOYDEVICEREMOVED)
    number = pad.get_instance_id()
    return Gamepad(speeds, lambda: [e for e in pygame.event.get(types) if e.instance_id == number], types)


def _now_if(moved: bool) -> float | None:
    return time.perf_counter() if moved else None
