"""How links are connected: joints of the tree, joints that follow others, and joints that close loops."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from enum import Enum
from typing import Any

import numpy as np

from orbit_core.scene.pose import Pose, Quaternion, Vector3


class JointType(Enum):
    """How a joint lets its child link move."""

    FIXED = "fixed"
    REVOLUTE = "revolute"
    """Rotation about the axis within limits, in radians."""
    CONTINUOUS = "continuous"
    """Rotation about the axis without limits; the position counts whole turns."""
    PRISMATIC = "prismatic"
    """Translation along the axis within limits, in metres."""


@dataclass(frozen=True)
class Mimic:
    """The joint follows another: ``position = offset + multiplier * x + higher_powers[0] * x^2 + ...``.

    ``x`` is the position of ``joint``, the leader. ``higher_powers`` are the coefficients of its square, its cube and
    its fourth power, three at most; without them the law is linear.
    """

    joint: str
    multiplier: float = 1.0
    offset: float = 0.0
    higher_powers: tuple[float, ...] = ()

    @property
    def linear(self) -> bool:
        """Whether the follower moves in proportion to its leader."""
        return not any(self.higher_powers)

    @property
    def coefficients(self) -> tuple[float, ...]:
        """Coefficients of the leader's powers, from the zeroth on."""
        return (self.offset, self.multiplier, *self.higher_powers)

    def position(self, leader: Any) -> Any:
        """The follower's position where the leader is at ``leader``: a number, an array or a tensor."""
        return _polynomial(self.coefficients, leader)

    def slope(self, leader: Any) -> Any:
        """Velocity of the follower per unit of the leader's, where the leader is at ``leader``."""
        return _polynomial([power * factor for power, factor in enumerate(self.coefficients)][1:], leader)


def _polynomial(coefficients: Sequence[float], x: Any) -> Any:
    """Horner's scheme, from the highest power down; of the shape of ``x``."""
    value = x * 0.0 + coefficients[-1]
    for coefficient in reversed(coefficients[:-1]):
        value = value * x + coefficient
    return value


@dataclass(frozen=True)
class Joint:
    """Connects ``child`` to ``parent``.

    The joint frame is fixed at ``parent_pose`` in the parent link and at ``child_pose`` in the child link; the two
    coincide at position zero, and the joint moves the second along or about ``axis`` (unit vector in the joint frame).
    Efforts are N or N m, velocities m/s or rad/s, after the joint's type.

    ``damping`` (N s/m or N m s/rad), ``friction`` (N or N m, Coulomb) and the spring are the mechanism's own, not a
    drive's. The spring's effort is ``-stiffness * (position - rest_position)``, ``stiffness`` in N/m or N m/rad,
    ``rest_position`` in m or rad; effort limits do not bound it. ``armature`` is the reflected inertia of the motor
    (kg or kg m^2).
    """

    name: str
    type: JointType
    parent: str
    child: str
    parent_pose: Pose = field(default_factory=Pose)
    child_pose: Pose = field(default_factory=Pose)
    axis: Vector3 = (0.0, 0.0, 1.0)
    lower_limit: float = -np.inf
    upper_limit: float = np.inf
    effort_limit: float = np.inf
    velocity_limit: float = np.inf
    damping: float = 0.0
    friction: float = 0.0
    armature: float = 0.0
    mimic: Mimic | None = None
    stiffness: float = 0.0
    rest_position: float = 0.0

    @property
    def movable(self) -> bool:
        """Whether the joint has a position."""
        return self.type is not JointType.FIXED


class LoopType(Enum):
    """What a joint that closes a loop holds together."""

    BALL = "ball"
    """A point of one link at a point of the other."""
    WELD = "weld"
    """The point, and the second link's orientation in the first."""


@dataclass(frozen=True)
class LoopJoint:
    """Closes a kinematic loop: holds a point of one link at a point of another, and a weld their orientation too.

    Each point is in its link's frame; ``orientation`` (w, x, y, z) is the second link's in the first and counts for a
    weld alone. The joint has no position of its own: those of the tree's joints must satisfy it, at home and whenever
    they are written.
    """

    name: str
    first: str
    second: str
    first_point: Vector3 = (0.0, 0.0, 0.0)
    second_point: Vector3 = (0.0, 0.0, 0.0)
    type: LoopType = LoopType.BALL
    orientation: Quaternion = (1.0, 0.0, 0.0, 0.0)


@dataclass(frozen=True)
class DriveGains:
    """What a file says of the drive on ``joint``; nothing acts by it until somebody takes it over.

    The effort is ``stiffness * (target - position) + damping * (target velocity - velocity)``, at most
    ``effort_limit`` (N or N m); stiffness is N/m or N m/rad, damping N s/m or N m s/rad. With both zero the drive is a
    plain motor.
    """

    joint: str
    stiffness: float = 0.0
    damping: float = 0.0
    effort_limit: float = np.inf
