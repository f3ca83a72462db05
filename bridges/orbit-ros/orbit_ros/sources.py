"""Sources of a robot of ROS in addition to its joints: cameras, inertial units, frames of bodies, and the clock."""

from __future__ import annotations

import importlib
import io
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from orbit_core.installing import install_command
from orbit_core.interfaces import ConfigurationError
from orbit_deploy.clocks import RobotClock
from orbit_deploy.pictures import CameraDescription, Picture, PictureKind
from orbit_ros import topics
from orbit_ros.body import rotation
from orbit_ros.messages import CameraInfo, Clock, CompressedImage, Image, Imu, TFMessage, seconds_of
from orbit_ros.node import RosNode

# Bytes of a pixel, and the places of red, green and blue in it
_COLORS = {
    "rgb8": (3, (0, 1, 2)), "bgr8": (3, (2, 1, 0)), "rgba8": (4, (0, 1, 2)), "bgra8": (4, (2, 1, 0)),
    "mono8": (1, (0, 0, 0)), "8UC1": (1, (0, 0, 0)), "8UC3": (3, (2, 1, 0)),
}  # fmt: skip
# Numbers of a pixel of depth, and metres of its unit
_DEPTHS = {"32FC1": ("f4", 1.0), "16UC1": ("u2", 1e-3), "mono16": ("u2", 1e-3)}
_COMPRESSED = "/compressed"
# Seconds that a simulated clock may stand still, and jump
_STILL = 0.5


@dataclass(frozen=True)
class RosSources:
    """Topics and frames of what a robot measures in addition to its joints, by the names that tasks have for them."""

    images: Mapping[str, str] = field(default_factory=dict)
    """Topics of colour pictures by camera; ``.../compressed`` holds JPEG or PNG."""
    depths: Mapping[str, str] = field(default_factory=dict)
    """Topics of depth pictures by camera, in the pixels of the colour pictures."""
    imus: Mapping[str, str] = field(default_factory=dict)
    """Topics of inertial units by sensor."""
    objects: Mapping[str, str] = field(default_factory=dict)
    """Topics of odometry by object."""
    frames: Mapping[str, str] = field(default_factory=dict)
    """Frames of ``tf`` by object."""
    world: str = topics.WORLD
    """Frame of ``tf`` that poses are in."""
    odometry: bool = True
    """False if nobody estimates where the base is: it stays at the origin, turned as its inertial unit measures."""
    clock: bool = False
    """True if time is that of ``clock``, as of a simulated robot that is faster or slower than real time."""


class RosCamera:
    """Camera of a robot of ROS.

    Args:
        node: connection to ROS.
        name: of the camera.
        color: topic of colour pictures; empty for none.
        depth: topic of depth pictures; empty for none.
        described: description, where the robot publishes it elsewhere; else ``camera_info`` next to the pictures.
    """

    def __init__(
        self, node: RosNode, name: str, color: str, depth: str, described: CameraDescription | None = None
    ) -> None:
        self.name = name
        """Name that tasks know it by."""
        self.description = described
        """Description of the camera; None until its calibration was heard."""
        self.fault = ""
        """Reason why a picture could not be used; empty without one."""
        self._topics = {PictureKind.RGB: color, PictureKind.DEPTH: depth}
        self._topics = {kind: topic for kind, topic in self._topics.items() if topic}
        self._sink: Callable[[Picture], None] | None = None
        self._now: Callable[[], int] = time.monotonic_ns
        first = next(iter(self._topics.values())).removesuffix(_COMPRESSED)
        self.info = f"{first.rpartition('/')[0]}/{topics.CAMERA_INFO}"
        """Topic of the calibration."""
        if described is None:
            node.subscribe(self.info, CameraInfo, self._take_info)
        for kind, topic in self._topics.items():
            message = CompressedImage if topic.endswith(_COMPRESSED) else Image
            node.subscribe(
                topic, message, lambda picture, _, kind=kind, topic=topic: self._take(kind, topic, picture), large=True
            )

    def watch(self, sink: Callable[[Picture], None], now: Callable[[], int]) -> None:
        """Hand pictures on from now on (:meth:`orbit_deploy.hardware.RobotHardware.watch`)."""
        self._now, self._sink = now, sink

    def _take_info(self, message: CameraInfo, _: str) -> None:
        if self.description is not None:
            return
        if message.distortion_model not in ("plumb_bob", ""):
            self.fault = f"'{self.info}' has distortion model '{message.distortion_model}': take rectified pictures"
            return
        k = np.array(message.k, np.float64).tolist()
        made = CameraDescription(
            name=self.name,
            width=message.width,
            height=message.height,
            focal=(k[0], k[4]),
            center=(k[2], k[5]),
            distortion=np.array(message.d, np.float64).tolist(),
            kinds=list(self._topics),
        )
        try:
            made.check()
        except ConfigurationError as error:
            self.fault = f"'{self.info}': {error}"
            return
        self.description = made

    def _take(self, kind: PictureKind, topic: str, message: Image | CompressedImage) -> None:
        if self._sink is None:
            return
        try:
            pixels = (_decoded if isinstance(message, CompressedImage) else _pixels)(message, kind)  # pyright: ignore[reportArgumentType]
        except ConfigurationError as error:
            self.fault = f"'{topic}': {error}"
            return
        height, width = pixels.shape[:2]
        # The time of arrival, as the camera's stamp is by a clock of another computer.
        self._sink(Picture(self.name, kind, self._now(), height, width, pixels.tobytes()))


def camera_messages(camera: CameraDescription, picture: Picture, header: Any) -> tuple[Image, CameraInfo]:
    """Return the messages of a picture.

    Args:
        camera: that took it.
        picture: of the camera.
        header: of both messages.
    """
    color = picture.kind is PictureKind.RGB
    size = picture.kind.dtype.itemsize * picture.kind.channels
    encoding = "rgb8" if color else "32FC1"
    image = Image(header, picture.height, picture.width, encoding, 0, picture.width * size, picture.data)  # pyright: ignore[reportArgumentType]
    (fx, fy), (cx, cy) = camera.focal, camera.center
    info = CameraInfo(
        header,
        camera.height,
        camera.width,
        d=camera.distortion or [0.0] * 5,
        k=[fx, 0.0, cx, 0.0, fy, cy, 0.0, 0.0, 1.0],  # pyright: ignore[reportArgumentType]
        r=[1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0],  # pyright: ignore[reportArgumentType]
        p=[fx, 0.0, cx, 0.0, 0.0, fy, cy, 0.0, 0.0, 0.0, 1.0, 0.0],  # pyright: ignore[reportArgumentType]
    )
    return image, info


def _pixels(message: Image, kind: PictureKind) -> np.ndarray:
    """Return the numbers (H, W, channels) of a picture as :class:`PictureKind` has them.

    Raises:
        ConfigurationError: its encoding is of another kind, or it lacks bytes.
    """
    known = _COLORS if kind is PictureKind.RGB else _DEPTHS
    if message.encoding not in known:
        raise ConfigurationError(f"{kind} pictures have encoding {', '.join(known)}, not '{message.encoding}'")
    size = _COLORS[message.encoding][0] if kind is PictureKind.RGB else int(_DEPTHS[message.encoding][0][1])
    if message.step < message.width * size or len(message.data) < message.height * message.step or not message.step:
        raise ConfigurationError(
            f"a picture of {message.width} by {message.height} pixels with rows of {message.step} bytes has "
            f"{len(message.data)} bytes"
        )
    # Rows may be padded.
    data = np.frombuffer(bytes(message.data), np.uint8)[: message.height * message.step]
    rows = data.reshape(message.height, message.step)[:, : message.width * size]
    if kind is PictureKind.RGB:
        return rows.reshape(message.height, message.width, size)[..., _COLORS[message.encoding][1]]
    number, unit = _DEPTHS[message.encoding]
    depths = np.ascontiguousarray(rows).view((">" if message.is_bigendian else "<") + number)
    return (depths.astype("<f4") * np.float32(unit))[..., None]


def _decoded(message: CompressedImage, kind: PictureKind) -> np.ndarray:
    """Return the numbers (H, W, 3) of a JPEG or PNG file.

    Raises:
        ConfigurationError: Pillow is not installed, or the bytes are no picture of colours.
    """
    try:
        library = importlib.import_module("PIL.Image")
    except ImportError:
        raise ConfigurationError(f"compressed pictures need Pillow: {install_command('orbit-ros[pictures]')}") from None
    if kind is not PictureKind.RGB:
        raise ConfigurationError("depth pictures are read uncompressed only: take the raw topic")
    try:
        with library.open(io.BytesIO(bytes(message.data)), formats=("JPEG", "PNG")) as opened:
            return np.asarray(opened.convert("RGB"))
    # Pillow raises many kinds for bytes that are no picture.
    except Exception as error:
        raise ConfigurationError(f"a compressed picture cannot be read: {error}") from None


class FrameTree:
    """Frames of ``tf`` and ``tf_static``: the newest transform of each frame in its parent's.

    Args:
        node: connection to ROS.
        world: frame that poses are in.
    """

    def __init__(self, node: RosNode, world: str) -> None:
        self._world, self._frames = world, dict[str, tuple[str, np.ndarray, float]]()
        self._last: dict[str, tuple[float, np.ndarray]] = {}
        node.subscribe(topics.TF, TFMessage, self._take)
        node.subscribe(topics.TF_STATIC, TFMessage, self._take, latched=True)

    def body(self, frame: str) -> list[float] | None:
        """Return pose (7) and velocity (6) of a frame in the world; None while it is not connected to it.

        The velocity is the difference of the last two poses, and zero for a frame that was seen once.
        """
        placed = self._matrix(frame)
        if placed is None:
            return None
        matrix, stamp = placed
        position, wxyz = matrix[:3, 3], _quaternion(matrix[:3, :3])
        velocity = np.zeros(6)
        before = self._last.get(frame)
        if before is not None and stamp > before[0]:
            turn = matrix[:3, :3] @ before[1][:3, :3].T
            angular = 0.5 * np.array((turn[2, 1] - turn[1, 2], turn[0, 2] - turn[2, 0], turn[1, 0] - turn[0, 1]))
            velocity = np.concatenate((position - before[1][:3, 3], angular)) / (stamp - before[0])
        self._last[frame] = stamp, matrix
        return [*position.tolist(), *wxyz.tolist(), *velocity.tolist()]

    def _matrix(self, frame: str) -> tuple[np.ndarray, float] | None:
        matrix, newest, seen = np.eye(4), 0.0, {frame}
        while frame != self._world:
            found = self._frames.get(frame)
            # A tree that another program publishes may be a circle.
            if found is None or (found[0] in seen):
                return None
            frame, step, stamp = found
            seen.add(frame)
            matrix, newest = step @ matrix, max(newest, stamp)
        return matrix, newest

    def _take(self, message: TFMessage, _: str) -> None:
        for each in message.transforms:
            at, turned = each.transform.translation, each.transform.rotation
            matrix = np.eye(4)
            matrix[:3, :3] = rotation(np.array((turned.w, turned.x, turned.y, turned.z)))
            matrix[:3, 3] = at.x, at.y, at.z
            # ROS 1 allowed a slash before names.
            child, parent = each.child_frame_id.lstrip("/"), each.header.frame_id.lstrip("/")
            self._frames[child] = parent, matrix, seconds_of(each.header.stamp)


def _quaternion(matrix: np.ndarray) -> np.ndarray:
    """Return the quaternion (w, x, y, z) of a rotation matrix (3, 3)."""
    # The eigenvector of the largest eigenvalue, which no rotation makes ill-conditioned.
    (xx, xy, xz), (yx, yy, yz), (zx, zy, zz) = matrix
    form = np.array(
        (
            (xx + yy + zz, zy - yz, xz - zx, yx - xy),
            (zy - yz, xx - yy - zz, xy + yx, xz + zx),
            (xz - zx, xy + yx, yy - xx - zz, yz + zy),
            (yx - xy, xz + zx, yz + zy, zz - xx - yy),
        )
    )
    found = np.linalg.eigh(form)[1][:, -1]
    return found if found[0] >= 0.0 else -found


def imu_row(message: Imu) -> list[float]:
    """Return orientation (w, x, y, z), angular velocity and linear acceleration (10) of an inertial unit."""
    turned, angular, linear = message.orientation, message.angular_velocity, message.linear_acceleration
    wxyz = [turned.w, turned.x, turned.y, turned.z]
    return [*wxyz, angular.x, angular.y, angular.z, linear.x, linear.y, linear.z]


@dataclass
class _Tick:
    """Newest time that a clock has published."""

    stamp: int = 0
    arrived: float = field(default_factory=time.monotonic)
    fault: str = ""


class RosClock(RobotClock):
    """Clock that a simulated robot publishes, which may be slower or faster than real time.

    Args:
        node: connection to ROS.
    """

    def __init__(self, node: RosNode) -> None:
        super().__init__()
        # The base is frozen, as other clocks never change.
        object.__setattr__(self, "_tick", _Tick())
        node.subscribe(topics.CLOCK, Clock, self._take)

    _tick: _Tick

    @property
    def known(self) -> bool:
        """True once it has been heard."""
        return self._tick.stamp > 0

    @property
    def fault(self) -> str:
        """Reason why the clock is of no use; empty while it runs."""
        still = time.monotonic() - self._tick.arrived
        if not self._tick.fault and still > _STILL:
            return f"the clock on '{topics.CLOCK}' has stood still for {still:.2f} s"
        return self._tick.fault

    def now(self) -> int:
        return self._tick.stamp

    def _take(self, message: Clock, _: str) -> None:
        stamp, tick = message.clock.sec * 1_000_000_000 + message.clock.nanosec, self._tick
        if stamp < tick.stamp - round(1e9 * _STILL):
            tick.fault = f"the clock on '{topics.CLOCK}' jumped by {1e-9 * (stamp - tick.stamp):+.3g} s"
        if stamp > tick.stamp:
            tick.stamp, tick.arrived = stamp, time.monotonic()
