"""``cmd_vel`` of a mobile base: velocities of its joints or wheels for a twist, and back."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Self

import numpy as np

from orbit_assets.catalogue import robot
from orbit_core.interfaces import UnknownNameError
from orbit_core.scene import DifferentialBase, PlanarBase
from orbit_deploy.description import FloatArray, RobotDescription
from orbit_ros.messages import Twist, Vector3


@dataclass(frozen=True)
class BaseTwist:
    """Joints that move a base: those of a plane, or two wheels."""

    joints: tuple[int, ...]
    """Places of x, y and yaw, or of the left and the right wheel, in the order of the robot's joints."""
    wheels: DifferentialBase | None
    """Wheels; None for a planar base."""

    @classmethod
    def of(cls, description: RobotDescription) -> Self | None:
        """Return the base of a robot of the catalogue; None if it has none."""
        try:
            spec = robot(description.model)
        except UnknownNameError:
            return None
        base: PlanarBase | DifferentialBase | None = spec.planar_base or spec.differential_base
        if base is None:
            return None
        names = (base.x, base.y, base.yaw) if isinstance(base, PlanarBase) else (base.left, base.right)
        if not all(name in description.joints for name in names):
            return None
        joints = tuple(description.joints.index(name) for name in names)
        return cls(joints, None if isinstance(base, PlanarBase) else base)

    def velocities(self, twist: Twist, positions: FloatArray) -> FloatArray:
        """Return velocities (J,) of all joints, zero for those that are not the base's.

        Args:
            twist: in the base's own axes.
            positions: (J,) measured positions.
        """
        forward, left, turn = twist.linear.x, twist.linear.y, twist.angular.z
        row = np.zeros(len(positions))
        if self.wheels is not None:
            # Wheels of a base that cannot go sideways leave that out.
            side = 0.5 * self.wheels.track * turn
            row[list(self.joints)] = np.array((forward - side, forward + side)) / self.wheels.radius
            return row
        cos, sin = math.cos(positions[self.joints[2]]), math.sin(positions[self.joints[2]])
        row[list(self.joints)] = cos * forward - sin * left, sin * forward + cos * left, turn
        return row

    def twist(self, velocities: FloatArray, positions: FloatArray) -> Twist:
        """Return the twist of joint velocities (J,), in the base's own axes."""
        own = velocities[list(self.joints)]
        if self.wheels is not None:
            speeds = own * self.wheels.radius
            forward, turn = float(speeds.mean()), float(speeds[1] - speeds[0]) / self.wheels.track
            return Twist(Vector3(forward), Vector3(z=turn))
        cos, sin = math.cos(positions[self.joints[2]]), math.sin(positions[self.joints[2]])
        forward, left = cos * own[0] + sin * own[1], cos * own[1] - sin * own[0]
        return Twist(Vector3(float(forward), float(left)), Vector3(z=float(own[2])))
