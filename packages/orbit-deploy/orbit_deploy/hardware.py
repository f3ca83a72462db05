"""The robot itself, as its computer drives it: targets in, measurements out, once a cycle."""

from __future__ import annotations

import functools
from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass, field
from urllib.parse import urlsplit

from orbit_core.interfaces import ConfigurationError, UnsupportedCapabilityError
from orbit_core.registry import Registry
from orbit_deploy.clocks import RobotClock
from orbit_deploy.description import FloatArray, RobotDescription
from orbit_deploy.follower import JointTargets
from orbit_deploy.messages import Arrangement
from orbit_deploy.pictures import Picture, PictureKind


@dataclass(frozen=True)
class Measurement:
    """State of a robot (J,) and of the objects that its computer tracks."""

    positions: FloatArray
    """rad or m"""
    velocities: FloatArray
    """rad/s or m/s"""
    efforts: FloatArray
    """N m or N"""
    objects: list[list[float]] = field(default_factory=list)
    """Pose (7) and velocity (6) of each tracked object."""
    imus: list[list[float]] = field(default_factory=list)
    """Orientation (4), angular velocity (3) and linear acceleration (3) of each inertial unit, in its own axes."""


class RobotHardware(ABC):
    """One robot. All methods are called by the thread of the robot's loop."""

    description: RobotDescription
    """Joints, limits and rate; fixed before the loop begins."""
    clock: RobotClock | None = None
    """Clock that the robot's time passes by; None for that of the computer which drives it."""

    @abstractmethod
    def read(self) -> Measurement:
        """Return the present state; called only in cycles whose state is published."""

    @abstractmethod
    def drive(self, targets: JointTargets) -> None:
        """Apply targets for one cycle.

        Args:
            targets: within all limits, in the order of the description's joints.

        Raises:
            SimulationError, OSError: the robot fails; its loop ends with a fault.
        """

    def arrange(self, arrangement: Arrangement) -> Measurement:
        """Put the robot or an object somewhere, where the description says that it ``arranges``.

        Raises:
            UnsupportedCapabilityError: the robot is a real one.
        """
        raise UnsupportedCapabilityError(
            f"{type(self).__name__} is a real robot: place things by hand, and move it by its joints"
        )

    def watch(self, sink: Callable[[Picture], None], now: Callable[[], int]) -> None:
        """Start the robot's cameras; those without any have nothing to start.

        Args:
            sink: gets each picture, from any thread.
            now: returns ns on the robot's clock, for the pictures' stamps.
        """

    def look(self, camera: str, kind: PictureKind, stamp: int) -> Picture:
        """Take one picture at once, for a computer that runs in lockstep with its client.

        Args:
            camera: name of the camera.
            kind: quantity.
            stamp: ns on the robot's clock.

        Raises:
            UnsupportedCapabilityError: the robot is a real one, whose pictures come when they come.
        """
        raise UnsupportedCapabilityError(f"{type(self).__name__} takes no pictures in lockstep")

    def close(self) -> None:
        """Release the robot; idempotent."""


@functools.cache
def _drivers() -> Registry[Callable[[str, RobotDescription], RobotHardware]]:
    return Registry("robot driver", "orbit.robot_hardware")


def open_hardware(address: str, description: RobotDescription) -> RobotHardware:
    """Open a real robot by its address, whose scheme names a driver of the entry-point group ``orbit.robot_hardware``.

    Args:
        address: such as ``franka://172.16.0.2``.
        description: of the robot, as the catalogue has it.

    Raises:
        ConfigurationError: the address has no scheme.
        UnknownNameError: no driver of that scheme is installed.
        RobotLinkError: the robot does not answer.
    """
    scheme = urlsplit(address).scheme
    if "://" not in address or not scheme:
        raise ConfigurationError(f"'{address}' is no robot's address: give one such as franka://172.16.0.2")
    return _drivers().get(scheme)(address, description)
