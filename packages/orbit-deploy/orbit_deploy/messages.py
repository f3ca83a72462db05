"""Messages between a client and a robot's computer, independent of the bridge. Times are ns on the robot's clock."""

from __future__ import annotations

from enum import StrEnum

import msgspec

VERSION = 3
"""Version of these messages; a robot's computer refuses clients of another one."""


class Mode(StrEnum):
    """State of a robot's motion."""

    HOLDING = "holding"
    """At rest, holding the last position."""
    FOLLOWING = "following"
    """Following a client's commands."""
    MOVING = "moving"
    """Moving slowly to positions that were requested, as at a soft start."""
    STOPPING = "stopping"
    """Coming to rest within limits."""
    FAULT = "fault"
    """At rest after a fault, until the client clears it or leaves."""


class JointCommand(msgspec.Struct, frozen=True, array_like=True, tag="command"):
    """Targets of all joints at one time."""

    sequence: int
    """Number that grows with each command of a session."""
    stamp: int
    """Time of the command on the robot's clock, ns."""
    positions: list[float]
    """rad or m"""
    velocities: list[float]
    """rad/s or m/s"""
    efforts: list[float]
    """N m or N, added to what the drives apply."""


class RobotState(msgspec.Struct, frozen=True, array_like=True, tag="state"):
    """Measurements of one cycle."""

    sequence: int
    """Number of the cycle."""
    stamp: int
    """Time of the measurement on the robot's clock, ns."""
    mode: Mode
    """Activity of the robot in this cycle."""
    command: int
    """Number of the newest command that was accepted; -1 before the first."""
    age: float
    """Seconds since that command arrived."""
    positions: list[float]
    """Measured positions (J), rad or m."""
    velocities: list[float]
    """Measured velocities (J), rad/s or m/s."""
    efforts: list[float]
    """Measured or estimated efforts (J), N m or N."""
    targets: list[float]
    """Positions that the drives were given, within limits."""
    target_velocities: list[float]
    """Velocities that the drives were given, rad/s or m/s."""
    target_efforts: list[float]
    """Efforts that were added to the drives', N m or N."""
    objects: list[list[float]]
    """Pose (7) and velocity (6) of each tracked object, in the order of the description."""
    clamped: int
    """Commands that were clamped to limits, in this session."""
    limited: int
    """Cycles in which the limits held the joints back from the path, in this session."""
    late: int
    """Commands that arrived after their time, in this session."""
    stops: int
    """Stops for want of commands, in this session."""
    imus: list[list[float]] = []
    """Orientation (w, x, y, z), angular velocity (rad/s) and linear acceleration (m/s^2) of each inertial unit, in its
    own axes and in the order of the description."""


class Fault(msgspec.Struct, frozen=True, array_like=True, tag="fault"):
    """Reason why the robot stopped. After ``watchdog`` and ``overrun`` the next command continues."""

    stamp: int
    """Time on the robot's clock, ns."""
    code: str
    """Kind: ``limit``, ``jump``, ``nan``, ``time``, ``shape``, ``watchdog``, ``robot``, ``overrun``."""
    text: str
    """Reason in words, with the numbers that led to it."""


PASSING = ("watchdog", "overrun")
"""Codes of faults after which the next command continues."""


class Arrangement(msgspec.Struct, frozen=True, array_like=True, tag="arrange"):
    """Request to a simulated robot to put itself or an object somewhere."""

    reset: bool = False
    """Return the whole scene to its initial state first."""
    positions: list[float] | None = None
    """Joint positions of the robot, which then rests."""
    object: str = ""
    """Name of the object that is put at ``pose``."""
    pose: list[float] | None = None
    """Position (m) and quaternion (w, x, y, z) in the environment's frame."""
