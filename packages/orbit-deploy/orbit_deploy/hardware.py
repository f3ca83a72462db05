"""The robot itself, as its computer drives it: targets in, measurements out, once a cycle."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass, field

from orbit_core.interfaces import UnsupportedCapabilityError
from orbit_deploy.description import FloatArray, RobotDescription
from orbit_deploy.follower import JointTargets
from orbit_deploy.messages import Arrangement


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


class RobotHardware(ABC):
    """One robot. All methods are called by the thread of the robot's loop."""

    description: RobotDescription
    """Joints, limits and rate; fixed before the loop begins."""

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

    def close(self) -> None:
        """Release the robot; idempotent."""
