"""A client's connection to a robot's computer over any bridge, and the registry of bridges."""

from __future__ import annotations

import functools
import time
from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Protocol
from urllib.parse import urlsplit

from orbit_core.interfaces import ConfigurationError, OrbitError
from orbit_core.registry import Registry
from orbit_deploy.clocks import ClockOffset, Latencies
from orbit_deploy.computer import RobotComputer
from orbit_deploy.description import RobotDescription
from orbit_deploy.follower import PathKind
from orbit_deploy.messages import Arrangement, Fault, Mode, RobotState
from orbit_deploy.pictures import CameraDescription, Picture, PictureBox, PictureKind

# Seconds between looks at a motion that is waited for
_LOOK = 0.01
# rad/s or m/s below which a joint stands still, and seconds that drives with a noisy measurement get for it
_SLOW, _SETTLING = 0.02, 1.0
# Seconds that a slow motion may take
_LONGEST_MOTION = 60.0


class RobotLinkError(OrbitError):
    """A robot that is not there, speaks another version, refuses a client, or no longer answers."""


class RobotFaultError(OrbitError):
    """A fault that stopped the robot."""


class RobotLink(ABC):
    """Session with one robot's computer. A link is used by one thread."""

    address: str
    """Address, for messages."""
    description: RobotDescription
    """Robot as its computer offered it."""
    offset: ClockOffset
    """Estimate of the robot's clock."""
    round_trips: Latencies
    """Seconds from a command to the first state that says that it was accepted."""
    ages: Latencies
    """Age of the states when they were used, s."""
    pictures: PictureBox
    """Newest pictures of the robot's cameras."""
    permit: Callable[[], None] | None = None
    """Called while a motion is waited for; the robot stops where it raises an error."""

    @abstractmethod
    def send(self, positions: Sequence[float], velocities: Sequence[float], efforts: Sequence[float]) -> None:
        """Send targets of all joints, stamped with the present time of the robot's clock.

        Args:
            positions: rad or m.
            velocities: rad/s or m/s.
            efforts: N m or N.
        """

    @abstractmethod
    def state(self) -> RobotState:
        """Return the newest state.

        Raises:
            RobotLinkError: the robot no longer answers.
            RobotFaultError: a fault stopped it; :meth:`clear` lets it go on.
        """

    def picture(self, camera: CameraDescription, kind: PictureKind, since: int = 0) -> Picture:
        """Return the newest picture of a camera, waiting for one that was taken late enough.

        Args:
            camera: of the robot.
            kind: quantity.
            since: ns on the robot's clock before which pictures show what is no longer so.

        Raises:
            ConfigurationError: the camera is silent.
        """
        return self.pictures.newest(camera, kind, since)

    @abstractmethod
    def move_to(self, positions: Sequence[float]) -> RobotState:
        """Begin a slow motion to positions, rad or m."""

    @abstractmethod
    def arrange(self, arrangement: Arrangement) -> RobotState:
        """Put a simulated robot or an object somewhere.

        Raises:
            OrbitError: the robot is a real one, or there is no such object.
        """

    @abstractmethod
    def clear(self) -> RobotState:
        """Clear a fault."""

    @abstractmethod
    def stop(self) -> None:
        """Request the robot to stop."""

    @abstractmethod
    def close(self) -> None:
        """Leave the robot, which stops; idempotent."""

    def now(self) -> float:
        """Return seconds on the clock that :meth:`wait` waits by."""
        return time.monotonic()

    def wait(self, until: float) -> None:
        """Wait until a time of :meth:`now`; returns at once if it has passed."""
        if (left := until - time.monotonic()) > 0.0:
            time.sleep(left)

    def finish_motion(self, timeout: float = _LONGEST_MOTION) -> RobotState:
        """Wait until the robot holds still after :meth:`move_to` or :meth:`stop`, and its drives have followed.

        Raises:
            RobotLinkError: it still moves after ``timeout`` seconds.
            OrbitError: :attr:`permit` ended the motion.
        """
        end, held = self.now() + timeout, 0.0
        while True:
            if self.permit is not None:
                try:
                    self.permit()
                except OrbitError:
                    self.stop()
                    raise
            state = self.state()
            # The targets rest first; soft drives follow them for a while.
            resting = state.mode in (Mode.HOLDING, Mode.FAULT)
            held = held + _LOOK if resting else 0.0
            slow = all(abs(speed) < _SLOW for speed in state.velocities)
            if resting and (slow or held > _SETTLING):
                return state
            if self.now() > end:
                raise RobotLinkError(f"the robot at {self.address} is still {state.mode} after {timeout:g} s")
            self.wait(self.now() + _LOOK)


def misfit(state: RobotState, description: RobotDescription) -> str:
    """Return the name of a state's list that does not fit the robot's description; empty if all do.

    Args:
        state: of another computer, whose numbers may be of another robot.
        description: of the robot.
    """
    joints = len(description.joints)
    for name in ("positions", "velocities", "efforts", "targets", "target_velocities", "target_efforts"):
        if len(getattr(state, name)) != joints:
            return name
    for name, rows, width in (("objects", description.objects, 13), ("imus", description.imus, 10)):
        values = getattr(state, name)
        if len(values) != len(rows) or any(len(row) != width for row in values):
            return name
    return ""


def fault_error(fault: Fault, address: str) -> RobotFaultError:
    """Return the error of a fault."""
    return RobotFaultError(f"the robot at {address} has stopped ({fault.code}): {fault.text}")


class BridgeServer(Protocol):
    """Side of a bridge that runs next to a robot's loop."""

    address: str
    """Address that clients connect to."""

    def close(self) -> None:
        """Stop serving; idempotent."""
        ...


class Bridge(Protocol):
    """Carrier of messages; the entry-point group ``orbit.bridges`` names modules or objects with these functions."""

    def connect(
        self, address: str, period: float, keys: Path | None = None, path: PathKind = PathKind.QUINTIC
    ) -> RobotLink:
        """Connect to a robot and begin a session.

        Args:
            address: with the bridge's scheme, such as ``zmq://127.0.0.1:5555``.
            period: seconds between commands.
            keys: folder of keys; none on this machine.
            path: way in which commands become a path.

        Raises:
            RobotLinkError: there is no robot, it is of another version, or another client has it.
        """
        ...

    def serve(self, computer: RobotComputer, address: str, keys: Path | None = None) -> BridgeServer:
        """Serve a robot's computer.

        Args:
            computer: of the robot, whose loop runs elsewhere.
            address: to listen at.
            keys: folder of keys; none on this machine.

        Raises:
            ConfigurationError: the address is taken, is none, or is reached from elsewhere and there are no keys.
        """
        ...


@functools.cache
def _bridges() -> Registry[Bridge]:
    return Registry[Bridge]("bridge", "orbit.bridges")


def bridge(name: str) -> Bridge:
    """Return the bridge of a scheme.

    Raises:
        UnknownNameError: none is installed.
    """
    return _bridges().get(name)


def connect(address: str, period: float, keys: Path | None = None, path: PathKind = PathKind.QUINTIC) -> RobotLink:
    """Connect to a robot by its address, whose scheme names the bridge (:meth:`Bridge.connect`).

    Raises:
        ConfigurationError: it has no scheme.
        UnknownNameError: no bridge of that scheme is installed.
        RobotLinkError: there is no robot, it is of another version, or another client has it.
    """
    scheme = urlsplit(address).scheme
    if "://" not in address or not scheme:
        raise ConfigurationError(f"'{address}' is no robot's address: give one such as zmq://127.0.0.1:5555")
    return bridge(scheme).connect(address, period, keys, path)
