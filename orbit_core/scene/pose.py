"""A rigid transform as plain data, for building scenes. Batched transforms are in :mod:`orbit_core.dynamics`."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

Vector3 = tuple[float, float, float]
Quaternion = tuple[float, float, float, float]
FloatArray = npt.NDArray[np.float64]


@dataclass(frozen=True)
class Pose:
    """Position (3,) in metres and unit quaternion ``(w, x, y, z)`` of one frame in another."""

    position: Vector3 = (0.0, 0.0, 0.0)
    """m."""
    orientation: Quaternion = (1.0, 0.0, 0.0, 0.0)
    """Unit quaternion (w, x, y, z)."""

    def __post_init__(self) -> None:
        # NumPy's scalars and arrays become Python's numbers: arrays neither compare nor hash, and USD takes no float32.
        object.__setattr__(self, "position", tuple(map(float, self.position)))
        object.__setattr__(self, "orientation", tuple(map(float, self.orientation)))

    def __matmul__(self, other: Pose) -> Pose:
        """Return the pose of ``other``, given in this frame, in this frame's parent."""
        return Pose(_placed(self, other.position), _multiply(self.orientation, other.orientation))

    def inverse(self) -> Pose:
        """Return the parent's pose in this frame."""
        w, x, y, z = self.orientation
        x0, y0, z0 = self.position
        back = Pose(orientation=(w, -x, -y, -z))
        return Pose(_placed(back, (-x0, -y0, -z0)), back.orientation)

    def rotation_matrix(self) -> FloatArray:
        """Return the rotation (3, 3) that takes vectors of this frame into the parent's axes."""
        w, x, y, z = self.orientation
        return np.array(
            [
                [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
                [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
                [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
            ]
        )

    def transform(self, points: npt.ArrayLike) -> FloatArray:
        """Return points (..., 3) of this frame in the parent's."""
        return np.asarray(points, dtype=float) @ self.rotation_matrix().T + np.asarray(self.position)

    def matrix(self) -> FloatArray:
        """Return the homogeneous transform (4, 4)."""
        result = np.eye(4)
        result[:3, :3] = self.rotation_matrix()
        result[:3, 3] = self.position
        return result

    @staticmethod
    def from_matrix(matrix: npt.ArrayLike) -> Pose:
        """Return the pose of a rotation (3, 3) or a homogeneous transform (4, 4); the rotation must be proper."""
        values = np.asarray(matrix, dtype=float)
        position = _vector(values[:3, 3]) if values.shape == (4, 4) else (0.0, 0.0, 0.0)
        return Pose(position, _quaternion_of_matrix(values[:3, :3]))

    @staticmethod
    def from_euler(roll: float, pitch: float, yaw: float, position: Vector3 = (0.0, 0.0, 0.0)) -> Pose:
        """Return the pose of fixed-axis roll, pitch and yaw (rad): ``Rz(yaw) Ry(pitch) Rx(roll)``, as in URDF."""
        cr, sr = math.cos(roll / 2), math.sin(roll / 2)
        cp, sp = math.cos(pitch / 2), math.sin(pitch / 2)
        cy, sy = math.cos(yaw / 2), math.sin(yaw / 2)
        quaternion = (
            cr * cp * cy + sr * sp * sy,
            sr * cp * cy - cr * sp * sy,
            cr * sp * cy + sr * cp * sy,
            cr * cp * sy - sr * sp * cy,
        )
        return Pose(position, canonical(quaternion))

    @staticmethod
    def from_axis_angle(axis: Vector3, angle: float, position: Vector3 = (0.0, 0.0, 0.0)) -> Pose:
        """Return the rotation by ``angle`` radians about ``axis``, which need not have unit length."""
        length = math.sqrt(sum(component * component for component in axis))
        # Dividing by the length here normalises the axis.
        s = math.sin(angle / 2) / length
        return Pose(position, canonical((math.cos(angle / 2), axis[0] * s, axis[1] * s, axis[2] * s)))


def look_at(eye: Vector3, target: Vector3, up: Vector3 = (0.0, 0.0, 1.0)) -> Pose:
    """Return the pose of a camera at ``eye`` that looks at ``target``.

    The camera looks along -z and y is up, the convention of USD and OpenGL.

    Args:
        eye: position of the camera.
        target: point in the middle of the picture.
        up: direction that appears upright in the picture.
    """
    backward = np.asarray(eye, dtype=float) - np.asarray(target, dtype=float)
    backward /= np.linalg.norm(backward)
    right = np.cross(np.asarray(up, dtype=float), backward)
    if np.linalg.norm(right) < 1e-9:  # looking along `up`: any right direction will do
        right = np.cross((0.0, 1.0, 0.0), backward)
    right /= np.linalg.norm(right)
    rotation = np.stack([right, np.cross(backward, right), backward], axis=1)
    return Pose(eye, _quaternion_of_matrix(rotation))


def canonical(quaternion: Quaternion) -> Quaternion:
    """Return the unit quaternion of the same rotation with w >= 0."""
    norm = math.sqrt(sum(component * component for component in quaternion))
    sign = -1.0 if quaternion[0] < 0 else 1.0
    w, x, y, z = (sign * component / norm for component in quaternion)
    return (w, x, y, z)


def _placed(pose: Pose, point: Vector3) -> Vector3:
    # Plain arithmetic: files of ten thousand links place as many points, one by one.
    w, x, y, z = pose.orientation
    px, py, pz = point
    return (
        pose.position[0] + (1 - 2 * (y * y + z * z)) * px + 2 * (x * y - w * z) * py + 2 * (x * z + w * y) * pz,
        pose.position[1] + 2 * (x * y + w * z) * px + (1 - 2 * (x * x + z * z)) * py + 2 * (y * z - w * x) * pz,
        pose.position[2] + 2 * (x * z - w * y) * px + 2 * (y * z + w * x) * py + (1 - 2 * (x * x + y * y)) * pz,
    )


def _vector(values: npt.ArrayLike) -> Vector3:
    x, y, z = (float(value) for value in np.asarray(values))
    return (x, y, z)


def _multiply(a: Quaternion, b: Quaternion) -> Quaternion:
    return canonical(
        (
            a[0] * b[0] - a[1] * b[1] - a[2] * b[2] - a[3] * b[3],
            a[0] * b[1] + a[1] * b[0] + a[2] * b[3] - a[3] * b[2],
            a[0] * b[2] - a[1] * b[3] + a[2] * b[0] + a[3] * b[1],
            a[0] * b[3] + a[1] * b[2] - a[2] * b[1] + a[3] * b[0],
        )
    )


def _quaternion_of_matrix(m: FloatArray) -> Quaternion:
    # Shepperd's method: divide by the largest of the four components, so that no divisor is small.
    trace = m[0, 0] + m[1, 1] + m[2, 2]
    largest = int(np.argmax([trace, m[0, 0], m[1, 1], m[2, 2]]))
    if largest == 0:
        q = (1 + trace, m[2, 1] - m[1, 2], m[0, 2] - m[2, 0], m[1, 0] - m[0, 1])
    elif largest == 1:
        q = (m[2, 1] - m[1, 2], 1 + 2 * m[0, 0] - trace, m[0, 1] + m[1, 0], m[0, 2] + m[2, 0])
    elif largest == 2:
        q = (m[0, 2] - m[2, 0], m[0, 1] + m[1, 0], 1 + 2 * m[1, 1] - trace, m[1, 2] + m[2, 1])
    else:
        q = (m[1, 0] - m[0, 1], m[0, 2] + m[2, 0], m[1, 2] + m[2, 1], 1 + 2 * m[2, 2] - trace)
    w, x, y, z = (float(component) for component in q)
    return canonical((w, x, y, z))
