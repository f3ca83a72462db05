"""Messages of ROS as data, with ROS 2's type names; ROS 1 has the same fields (:mod:`orbit_ros.ros1`).

Members and their units are those of ROS's interface definitions: https://docs.ros.org/en/rolling/p/sensor_msgs/ and its
neighbours.
"""

# Types are read when the classes are made, so that their annotations are no strings.
import struct
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

from cyclonedds.idl import IdlStruct
from cyclonedds.idl.types import float64, int32, uint8, uint32

if TYPE_CHECKING:
    # Values are lists, which Cyclone's own marks do not say.
    from collections.abc import Sequence as sequence
    from typing import Annotated as array
else:
    from cyclonedds.idl.types import array, sequence


@dataclass
class Time(IdlStruct, typename="builtin_interfaces.msg.dds_.Time_"):
    """Time stamp."""

    sec: int32 = 0
    nanosec: uint32 = 0


@dataclass
class Duration(IdlStruct, typename="builtin_interfaces.msg.dds_.Duration_"):
    """Length of time."""

    sec: int32 = 0
    nanosec: uint32 = 0


@dataclass
class Header(IdlStruct, typename="std_msgs.msg.dds_.Header_"):
    """Time and frame of a message."""

    stamp: Time = field(default_factory=Time)
    frame_id: str = ""


@dataclass
class String(IdlStruct, typename="std_msgs.msg.dds_.String_"):
    """Text."""

    data: str = ""


@dataclass
class Empty(IdlStruct, typename="std_msgs.msg.dds_.Empty_"):
    """Signal without content; DDS has no struct without members."""

    structure_needs_at_least_one_member: uint8 = 0


@dataclass
class MultiArrayDimension(IdlStruct, typename="std_msgs.msg.dds_.MultiArrayDimension_"):
    """Axis of an array."""

    label: str = ""
    size: uint32 = 0
    stride: uint32 = 0


@dataclass
class MultiArrayLayout(IdlStruct, typename="std_msgs.msg.dds_.MultiArrayLayout_"):
    """Axes of an array."""

    dim: sequence[MultiArrayDimension] = field(default_factory=list)
    data_offset: uint32 = 0


@dataclass
class Float64MultiArray(IdlStruct, typename="std_msgs.msg.dds_.Float64MultiArray_"):
    """Numbers, such as the commands of ros2_control's forward controllers."""

    layout: MultiArrayLayout = field(default_factory=MultiArrayLayout)
    data: sequence[float64] = field(default_factory=list)


@dataclass
class JointState(IdlStruct, typename="sensor_msgs.msg.dds_.JointState_"):
    """Measured joints, rad or m, by name."""

    header: Header = field(default_factory=Header)
    name: sequence[str] = field(default_factory=list)
    position: sequence[float64] = field(default_factory=list)
    velocity: sequence[float64] = field(default_factory=list)
    effort: sequence[float64] = field(default_factory=list)


@dataclass
class JointTrajectoryPoint(IdlStruct, typename="trajectory_msgs.msg.dds_.JointTrajectoryPoint_"):
    """Targets at one time after the trajectory's start."""

    positions: sequence[float64] = field(default_factory=list)
    velocities: sequence[float64] = field(default_factory=list)
    accelerations: sequence[float64] = field(default_factory=list)
    effort: sequence[float64] = field(default_factory=list)
    time_from_start: Duration = field(default_factory=Duration)


@dataclass
class JointTrajectory(IdlStruct, typename="trajectory_msgs.msg.dds_.JointTrajectory_"):
    """Targets of joints by name, one point after another."""

    header: Header = field(default_factory=Header)
    joint_names: sequence[str] = field(default_factory=list)
    points: sequence[JointTrajectoryPoint] = field(default_factory=list)


@dataclass
class Vector3(IdlStruct, typename="geometry_msgs.msg.dds_.Vector3_"):
    """Vector."""

    x: float64 = 0.0
    y: float64 = 0.0
    z: float64 = 0.0


@dataclass
class Point(IdlStruct, typename="geometry_msgs.msg.dds_.Point_"):
    """Position, m."""

    x: float64 = 0.0
    y: float64 = 0.0
    z: float64 = 0.0


@dataclass
class Quaternion(IdlStruct, typename="geometry_msgs.msg.dds_.Quaternion_"):
    """Orientation; ROS puts the scalar last."""

    x: float64 = 0.0
    y: float64 = 0.0
    z: float64 = 0.0
    w: float64 = 1.0


@dataclass
class Pose(IdlStruct, typename="geometry_msgs.msg.dds_.Pose_"):
    """Position and orientation."""

    position: Point = field(default_factory=Point)
    orientation: Quaternion = field(default_factory=Quaternion)


@dataclass
class Twist(IdlStruct, typename="geometry_msgs.msg.dds_.Twist_"):
    """Linear (m/s) and angular velocity (rad/s)."""

    linear: Vector3 = field(default_factory=Vector3)
    angular: Vector3 = field(default_factory=Vector3)


@dataclass
class PoseWithCovariance(IdlStruct, typename="geometry_msgs.msg.dds_.PoseWithCovariance_"):
    """Pose and its covariance (6, 6), row by row."""

    pose: Pose = field(default_factory=Pose)
    covariance: array[float64, 36] = field(default_factory=lambda: [0.0] * 36)  # pyright: ignore[reportAssignmentType]


@dataclass
class TwistWithCovariance(IdlStruct, typename="geometry_msgs.msg.dds_.TwistWithCovariance_"):
    """Twist and its covariance (6, 6), row by row."""

    twist: Twist = field(default_factory=Twist)
    covariance: array[float64, 36] = field(default_factory=lambda: [0.0] * 36)  # pyright: ignore[reportAssignmentType]


@dataclass
class Transform(IdlStruct, typename="geometry_msgs.msg.dds_.Transform_"):
    """Translation and rotation."""

    translation: Vector3 = field(default_factory=Vector3)
    rotation: Quaternion = field(default_factory=Quaternion)


@dataclass
class TransformStamped(IdlStruct, typename="geometry_msgs.msg.dds_.TransformStamped_"):
    """Transform of a child frame in the header's frame."""

    header: Header = field(default_factory=Header)
    child_frame_id: str = ""
    transform: Transform = field(default_factory=Transform)


@dataclass
class TFMessage(IdlStruct, typename="tf2_msgs.msg.dds_.TFMessage_"):
    """Transforms of frames."""

    transforms: sequence[TransformStamped] = field(default_factory=list)


@dataclass
class Odometry(IdlStruct, typename="nav_msgs.msg.dds_.Odometry_"):
    """Pose in the header's frame, and twist in the child's frame."""

    header: Header = field(default_factory=Header)
    child_frame_id: str = ""
    pose: PoseWithCovariance = field(default_factory=PoseWithCovariance)
    twist: TwistWithCovariance = field(default_factory=TwistWithCovariance)


@dataclass
class Imu(IdlStruct, typename="sensor_msgs.msg.dds_.Imu_"):
    """Orientation, angular velocity (rad/s) and specific force (m/s^2) of an inertial measurement unit."""

    header: Header = field(default_factory=Header)
    orientation: Quaternion = field(default_factory=Quaternion)
    orientation_covariance: array[float64, 9] = field(default_factory=lambda: [0.0] * 9)  # pyright: ignore[reportAssignmentType]
    angular_velocity: Vector3 = field(default_factory=Vector3)
    angular_velocity_covariance: array[float64, 9] = field(default_factory=lambda: [0.0] * 9)  # pyright: ignore[reportAssignmentType]
    linear_acceleration: Vector3 = field(default_factory=Vector3)
    linear_acceleration_covariance: array[float64, 9] = field(default_factory=lambda: [0.0] * 9)  # pyright: ignore[reportAssignmentType]


_CDR, _CDR2 = bytes((0, 1, 0, 0)), bytes((0, 7, 0, 0))


def _header_bytes(header: Header) -> bytearray:
    """Return the beginning of a message's body."""
    body = bytearray(struct.pack("<iI", header.stamp.sec, header.stamp.nanosec))
    _put_text(body, header.frame_id)
    return body


def _header(body: memoryview, order: str) -> tuple[Header, int]:
    """Return a body's header and the place of what follows it."""
    sec, nanosec = struct.unpack_from(order + "iI", body, 0)
    frame, at = _text(body, 8, order)
    return Header(Time(sec, nanosec), frame), at


def _put_text(body: bytearray, text: str) -> None:
    data = text.encode() + b"\0"
    body += struct.pack("<I", len(data)) + data
    body += bytes(-len(body) % 4)


def _text(body: memoryview, at: int, order: str, align: int = 4) -> tuple[str, int]:
    """Return a text and the place of what follows it."""
    (length,) = struct.unpack_from(order + "I", body, at)
    # The length counts the zero at the text's end.
    end = at + 4 + length
    return bytes(body[at + 4 : end - 1]).decode(), end + -end % align


@dataclass
class Image(IdlStruct, typename="sensor_msgs.msg.dds_.Image_"):
    """Picture; ``data`` holds its rows from the top."""

    header: Header = field(default_factory=Header)
    height: uint32 = 0
    width: uint32 = 0
    encoding: str = "rgb8"
    is_bigendian: uint8 = 0
    step: uint32 = 0
    data: sequence[uint8] = field(default_factory=list)

    # Number by number, a picture of 640 by 480 takes Cyclone 200 ms.

    def serialize(self, buffer: Any = None, endianness: Any = None, use_version_2: bool | None = None) -> bytes:
        """Return the message as CDR."""
        body = _header_bytes(self.header)
        body += struct.pack("<II", self.height, self.width)
        encoding = self.encoding.encode() + b"\0"
        body += struct.pack("<I", len(encoding)) + encoding + bytes((self.is_bigendian,))
        # CDR aligns a number to its size, from the beginning of the body.
        body += bytes(-len(body) % 4) + struct.pack("<II", self.step, len(self.data))
        return (_CDR2 if use_version_2 else _CDR) + bytes(body) + bytes(self.data)

    @classmethod
    def deserialize(cls, data: bytes, has_header: bool = True, use_version_2: bool | None = None) -> "Image":
        """Return the message of CDR; numbers of big-endian writers are read too."""
        order = "<" if data[1] & 1 else ">"
        body = memoryview(data)[4 if has_header else 0 :]
        header, at = _header(body, order)
        height, width = struct.unpack_from(order + "II", body, at)
        encoding, at = _text(body, at + 8, order, 1)
        big, step, length = struct.unpack_from(order + f"B{-(at + 1) % 4}xII", body, at)
        at += 1 + -(at + 1) % 4 + 8
        return cls(header, height, width, encoding, big, step, bytes(body[at : at + length]))


@dataclass
class CompressedImage(IdlStruct, typename="sensor_msgs.msg.dds_.CompressedImage_"):
    """Picture as the bytes of a JPEG or PNG file."""

    header: Header = field(default_factory=Header)
    format: str = "jpeg"
    data: sequence[uint8] = field(default_factory=list)

    def serialize(self, buffer: Any = None, endianness: Any = None, use_version_2: bool | None = None) -> bytes:
        """Return the message as CDR."""
        body = _header_bytes(self.header)
        _put_text(body, self.format)
        body += struct.pack("<I", len(self.data))
        return (_CDR2 if use_version_2 else _CDR) + bytes(body) + bytes(self.data)

    @classmethod
    def deserialize(cls, data: bytes, has_header: bool = True, use_version_2: bool | None = None) -> "CompressedImage":
        """Return the message of CDR; numbers of big-endian writers are read too."""
        order = "<" if data[1] & 1 else ">"
        body = memoryview(data)[4 if has_header else 0 :]
        header, at = _header(body, order)
        kind, at = _text(body, at, order)
        (length,) = struct.unpack_from(order + "I", body, at)
        return cls(header, kind, bytes(body[at + 4 : at + 4 + length]))


@dataclass
class RegionOfInterest(IdlStruct, typename="sensor_msgs.msg.dds_.RegionOfInterest_"):
    """Part of a camera's picture; all zeros for the whole of it."""

    x_offset: uint32 = 0
    y_offset: uint32 = 0
    height: uint32 = 0
    width: uint32 = 0
    do_rectify: bool = False


@dataclass
class CameraInfo(IdlStruct, typename="sensor_msgs.msg.dds_.CameraInfo_"):
    """Calibration of a camera; ROS 1 writes ``d``, ``k``, ``r`` and ``p`` in capitals."""

    header: Header = field(default_factory=Header)
    height: uint32 = 0
    width: uint32 = 0
    distortion_model: str = "plumb_bob"
    d: sequence[float64] = field(default_factory=list)
    k: array[float64, 9] = field(default_factory=lambda: [0.0] * 9)  # pyright: ignore[reportAssignmentType]
    r: array[float64, 9] = field(default_factory=lambda: [0.0] * 9)  # pyright: ignore[reportAssignmentType]
    p: array[float64, 12] = field(default_factory=lambda: [0.0] * 12)  # pyright: ignore[reportAssignmentType]
    binning_x: uint32 = 0
    binning_y: uint32 = 0
    roi: RegionOfInterest = field(default_factory=RegionOfInterest)


@dataclass
class Clock(IdlStruct, typename="rosgraph_msgs.msg.dds_.Clock_"):
    """Time of the robot or of its simulation."""

    clock: Time = field(default_factory=Time)


TYPES: tuple[type[IdlStruct], ...] = (
    Time, Duration, Header, String, Empty, MultiArrayDimension, MultiArrayLayout, Float64MultiArray, JointState,
    JointTrajectoryPoint, JointTrajectory, Vector3, Point, Quaternion, Pose, Twist, PoseWithCovariance,
    TwistWithCovariance, Transform, TransformStamped, TFMessage, Odometry, Imu, Image, CompressedImage,
    RegionOfInterest, CameraInfo, Clock,
)  # fmt: skip


def ros_name(message: type[IdlStruct]) -> str:
    """Return a type's name in ROS 1, such as ``sensor_msgs/JointState``."""
    package, _, _, name = message.__idl_typename__.split(".")  # pyright: ignore[reportAttributeAccessIssue]
    return f"{package}/{name.removesuffix('_')}"


BY_NAME: dict[str, type[IdlStruct]] = {ros_name(each): each for each in TYPES}
"""Types by their names in ROS 1."""


def ros1_member(kind: type[IdlStruct], name: str) -> str:
    """Return the name that ROS 1 has for a member of a type."""
    return name.upper() if kind is CameraInfo and len(name) == 1 else name


def time_of(nanoseconds: int) -> Time:
    """Return the message of a time, ns."""
    return Time(nanoseconds // 1_000_000_000, nanoseconds % 1_000_000_000)


def seconds_of(time: Time | Duration) -> float:
    """Return a time or duration in seconds."""
    return time.sec + 1e-9 * time.nanosec


def duration_of(seconds: float) -> Duration:
    """Return the message of a duration, s."""
    nanoseconds = round(1e9 * seconds)
    return Duration(nanoseconds // 1_000_000_000, nanoseconds % 1_000_000_000)


def quaternion_of(wxyz: Any) -> Quaternion:
    """Return the message of an orientation (w, x, y, z)."""
    w, x, y, z = (float(value) for value in wxyz)
    return Quaternion(x, y, z, w)
