"""Poses and velocities of bodies as ROS states them: quaternions with the scalar last, twists in the body's frame."""

from __future__ import annotations

import numpy as np

from orbit_deploy.description import FloatArray
from orbit_ros.messages import (
    Header,
    Imu,
    Odometry,
    Point,
    Pose,
    PoseWithCovariance,
    Transform,
    TransformStamped,
    Twist,
    TwistWithCovariance,
    Vector3,
    quaternion_of,
)

GRAVITY = np.array([0.0, 0.0, 9.81])


def rotation(wxyz: FloatArray) -> FloatArray:
    """Return the rotation matrix (3, 3) of a quaternion (w, x, y, z)."""
    length = np.linalg.norm(wxyz)
    # Messages that were never filled in hold zeros.
    w, x, y, z = wxyz / length if length > 0.0 else (1.0, 0.0, 0.0, 0.0)
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )


def odometry(body: list[float], header: Header, child: str) -> Odometry:
    """Return the odometry of a body.

    Args:
        body: pose (7) and velocity (6) in the world.
        header: with the world's frame.
        child: the body's frame.
    """
    # ROS states twists in the child's frame, ORBIT in the world's.
    turn = rotation(np.array(body[3:7])).T
    linear, angular = (turn @ np.array(part) for part in (body[7:10], body[10:13]))
    pose = Pose(Point(*map(float, body[:3])), quaternion_of(body[3:7]))
    twist = Twist(_vector(linear), _vector(angular))
    return Odometry(header, child, PoseWithCovariance(pose), TwistWithCovariance(twist))


def body_of(message: Odometry) -> list[float]:
    """Return pose (7) and velocity (6) in the world of a body's odometry."""
    at, turned = message.pose.pose.position, message.pose.pose.orientation
    wxyz = [turned.w, turned.x, turned.y, turned.z]
    turn, twist = rotation(np.array(wxyz)), message.twist.twist
    linear, angular = (turn @ np.array([each.x, each.y, each.z]) for each in (twist.linear, twist.angular))
    return [at.x, at.y, at.z, *wxyz, *linear.tolist(), *angular.tolist()]


def transform(body: list[float], header: Header, child: str) -> TransformStamped:
    """Return the transform of a body's frame in the world's."""
    return TransformStamped(header, child, Transform(_vector(np.array(body[:3])), quaternion_of(body[3:7])))


class Accelerometer:
    """Specific force of a body in its own frame, from differences of its velocity."""

    def __init__(self) -> None:
        self._last: tuple[int, FloatArray] | None = None
        self.force = GRAVITY.copy()
        """(3,) m/s^2"""

    def update(self, body: list[float], stamp: int) -> FloatArray:
        """Return the specific force (3,) after a measurement at a time, ns."""
        velocity = np.array(body[7:10])
        # A repeated stamp, as of a state that is sent twice, would divide by zero.
        if self._last is not None and stamp > self._last[0]:
            acceleration = (velocity - self._last[1]) / (1e-9 * (stamp - self._last[0]))
            self.force = rotation(np.array(body[3:7])).T @ (acceleration + GRAVITY)
        self._last = (stamp, velocity)
        return self.force


def imu(body: list[float], force: FloatArray, header: Header) -> Imu:
    """Return what an inertial measurement unit at a body's origin measures."""
    angular = rotation(np.array(body[3:7])).T @ np.array(body[10:13])
    return Imu(
        header,
        orientation=quaternion_of(body[3:7]),
        angular_velocity=_vector(angular),
        linear_acceleration=_vector(force),
    )


def _vector(values: FloatArray) -> Vector3:
    return Vector3(*map(float, values))
