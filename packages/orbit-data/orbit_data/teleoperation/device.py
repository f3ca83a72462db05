"""Interface of all devices: readings of a person's current requests."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from enum import Enum

from orbit_core.interfaces.errors import ConfigurationError, OrbitError

FARTHEST = 1e4
"""Largest number (m, rad, m/s or rad/s) in a request. Beyond it single precision cannot represent millimetres."""
MOST_EVENTS = 32
"""Limit of events that wait for the next step; a person causes one or two."""


class DeviceLostError(OrbitError):
    """Error of a device that was unplugged, or whose other end disappeared."""


class Event(Enum):
    """Request that a person makes once, by a key or a button; the value is its word in messages and frames."""

    RECORD = "record"
    """Begin a new episode, and record it."""
    SAVE = "save"
    """End the episode that is recorded, and keep it."""
    DISCARD = "discard"
    """Discard the recorded episode, and begin a new one without recording."""
    RESET = "reset"
    """Begin a new episode; a recorded one is discarded, and the new one recorded."""
    SUCCESS = "success"
    """Mark the recorded episode as successful, or remove the mark."""
    GRIPPER = "gripper"
    """Open or close the gripper."""
    NEXT = "next"
    """Drive the next end effector, of the same robot or another, if there are several."""


def within_reach(numbers: Iterable[float]) -> bool:
    """Return True if all numbers are finite and at most :data:`FARTHEST`."""
    return all(abs(number) <= FARTHEST for number in numbers)


class EventQueue:
    """Queue of events that wait for the next reading, at most :data:`MOST_EVENTS`."""

    def __init__(self) -> None:
        self._waiting: list[Event] = []

    def __len__(self) -> int:
        return len(self._waiting)

    def add(self, event: Event) -> bool:
        """Add an event; return False if there are too many already, and this one is dropped."""
        if len(self._waiting) >= MOST_EVENTS:
            return False
        self._waiting.append(event)
        return True

    def take(self) -> tuple[Event, ...]:
        """Remove and return all events, oldest first."""
        waiting, self._waiting = self._waiting, []
        return tuple(waiting)


@dataclass(frozen=True)
class Reading:
    """Requests of a person at one moment; None where the device has none.

    Raises:
        ConfigurationError: a number is not finite or beyond :data:`FARTHEST`, or a quaternion has no length.
    """

    twist: tuple[float, ...] | None = None
    """Twist of the end effector: six numbers in m/s and rad/s, in world axes."""
    pose: tuple[float, ...] | None = None
    """Pose of the end effector: position (m) and quaternion (w, x, y, z), in the environment's frame."""
    joints: Mapping[str, float] | None = None
    """Positions in rad or m by the robot's joint names."""
    base: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """Command (forward, left, turn) of a base, as shares of its limits."""
    gripper_open: bool | None = None
    """Wanted state of the gripper; None keeps the last one."""
    events: tuple[Event, ...] = ()
    """Buttons pressed since the last reading, oldest first."""
    moved_at: float | None = None
    """``time.perf_counter()`` of the person's oldest action in the reading."""

    def __post_init__(self) -> None:
        joints = self.joints or {}
        for what, numbers in (("twist", self.twist), ("pose", self.pose), ("base", self.base)):
            if not within_reach(numbers or ()):
                raise ConfigurationError(f"the device requests {what} {numbers}: the limit is {FARTHEST:g}")
        for name, value in joints.items():
            if not within_reach((value,)):
                raise ConfigurationError(
                    f"the device requests position {value} of joint '{name}': the limit is {FARTHEST:g}"
                )
        if self.pose is not None and not any(self.pose[3:]):
            raise ConfigurationError("the device requests a pose whose quaternion is zero")


@dataclass(frozen=True)
class Speeds:
    """Speeds of the hand at a device's full deflection."""

    linear: float = 0.25
    """m/s"""
    angular: float = 1.0
    """rad/s"""

    def twist(self, shares: Sequence[float]) -> tuple[float, ...]:
        """Return the twist of six shares in [-1, 1]."""
        scales = (self.linear,) * 3 + (self.angular,) * 3
        return tuple(share * scale for share, scale in zip(shares, scales, strict=True))


class Device(ABC):
    """Device that a person moves."""

    @abstractmethod
    def read(self) -> Reading:
        """Return the current requests without waiting.

        Raises:
            DeviceLostError: the device has disappeared.
        """

    def tell(self, rows: Mapping[str, str]) -> None:
        """Show the person the session's state, if the device can."""

    def close(self) -> None:
        """Release the device."""
