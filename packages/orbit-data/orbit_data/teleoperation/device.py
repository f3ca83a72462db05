"""What every device gives: readings of what a person asks for now."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from enum import Enum

from orbit_core.interfaces.errors import ConfigurationError, OrbitError

FARTHEST = 1e4
"""m, rad, m/s or rad/s: the largest number that a device may ask for. Beyond it single precision has no millimetres."""
MOST_EVENTS = 32
"""Events that wait for the next step; a person asks for one or two."""


class DeviceLostError(OrbitError):
    """A device was unplugged, or its other end went away."""


class Event(Enum):
    """What a person asks for once, by a key or a button; the value is its word in messages and frames."""

    RECORD = "record"
    """Begin a new episode, and record it."""
    SAVE = "save"
    """End the episode that is recorded, and keep it."""
    DISCARD = "discard"
    """Forget the episode that is recorded, and begin anew without recording."""
    RESET = "reset"
    """Begin a new episode; one that is recorded is forgotten, and its successor recorded."""
    SUCCESS = "success"
    """Mark the episode that is recorded as successful, or take the mark back."""
    GRIPPER = "gripper"
    """Open or close the gripper."""
    NEXT = "next"
    """Drive the next end effector, of the same robot or another, where there are several."""


def within_reach(numbers: Iterable[float]) -> bool:
    """Return True if all numbers are finite and at most :data:`FARTHEST`."""
    return all(abs(number) <= FARTHEST for number in numbers)


class EventQueue:
    """Events that wait for the next reading, :data:`MOST_EVENTS` at most."""

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
        """Return all of them, oldest first, and forget them."""
        waiting, self._waiting = self._waiting, []
        return tuple(waiting)


@dataclass(frozen=True)
class Reading:
    """What a person asks for at one moment; None where the device says nothing of it.

    Raises:
        ConfigurationError: a number is not finite or beyond :data:`FARTHEST`, or a quaternion has no length.
    """

    twist: tuple[float, ...] | None = None
    """Six: m/s and rad/s of the end effector, in world axes."""
    pose: tuple[float, ...] | None = None
    """Seven: position (m) and quaternion (w, x, y, z) of the end effector, in the environment's frame."""
    joints: Mapping[str, float] | None = None
    """rad or m by the robot's joint names."""
    base: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """(forward, left, turn) of a base, as shares of its limits."""
    gripper_open: bool | None = None
    events: tuple[Event, ...] = ()
    moved_at: float | None = None
    """``time.perf_counter()`` of the oldest move of the person that the reading holds."""

    def __post_init__(self) -> None:
        joints = self.joints or {}
        for what, numbers in (("twist", self.twist), ("pose", self.pose), ("base", self.base)):
            if not within_reach(numbers or ()):
                raise ConfigurationError(f"the device asks for {what} {numbers}: give numbers up to {FARTHEST:g}")
        for name, value in joints.items():
            if not within_reach((value,)):
                raise ConfigurationError(f"the device wants joint '{name}' at {value}, which is no position")
        if self.pose is not None and not any(self.pose[3:]):
            raise ConfigurationError("the device asks for a pose whose quaternion is zero")


@dataclass(frozen=True)
class Speeds:
    """How fast the hand moves at a device's full deflection."""

    linear: float = 0.25
    """m/s"""
    angular: float = 1.0
    """rad/s"""

    def twist(self, shares: Sequence[float]) -> tuple[float, ...]:
        """Return the twist of six shares in [-1, 1]."""
        scales = (self.linear,) * 3 + (self.angular,) * 3
        return tuple(share * scale for share, scale in zip(shares, scales, strict=True))


class Device(ABC):
    """Something that a person moves."""

    @abstractmethod
    def read(self) -> Reading:
        """What is asked for now; waits for nothing.

        Raises:
            DeviceLostError: the device is gone.
        """

    def tell(self, rows: Mapping[str, str]) -> None:
        """Let the person know how things stand, where the device has a way to."""

    def close(self) -> None:
        """Give the device back."""
