"""Robot of the real ROS 1 (rospy) or ROS 2 (rclpy): publishes joints, pictures, an inertial unit, odometry, the clock.

Run it as ``python robot_program.py ros1`` or ``ros2``; a second word ``listen`` prints what our own robot publishes.
"""

from __future__ import annotations

import struct
import sys
import time
import zlib

WIDTH, HEIGHT = 320, 240
PANDA = [0.0, -0.5, 0.0, -2.8, 0.0, 3.0, 0.7, 0.02, 0.02]
NAMES = [*(f"panda_joint{i + 1}" for i in range(7)), "panda_finger_joint1", "panda_finger_joint2"]
GYRO, FORCE = (0.1, 0.2, 0.3), (1.0, 2.0, 9.8)
RED, BLUE = (250, 10, 20), (30, 20, 240)
# Simulated seconds in a second
SPEED = 2.0


def main(version: str, listen: bool) -> None:
    """Publish for a minute, or print what is heard until all of it was."""
    ros = Ros1() if version == "ros1" else Ros2()
    if listen:
        hear(ros)
    else:
        speak(ros)


def speak(ros: Ros1 | Ros2) -> None:
    """Publish as a robot."""
    from geometry_msgs.msg import TransformStamped  # pyright: ignore[reportMissingImports]
    from nav_msgs.msg import Odometry  # pyright: ignore[reportMissingImports]
    from rosgraph_msgs.msg import Clock  # pyright: ignore[reportMissingImports]
    from sensor_msgs.msg import (  # pyright: ignore[reportMissingImports]
        CameraInfo,
        CompressedImage,
        Image,
        Imu,
        JointState,
    )

    publish = {
        name: ros.publisher(kind, name)
        for name, kind in {
            "joint_states": JointState, "imu/data": Imu, "camera/color/image_raw": Image,
            "camera/color/image_raw/compressed": CompressedImage, "camera/depth/image_raw": Image,
            "camera/color/camera_info": CameraInfo, "tag/odom": Odometry, "clock": Clock,
        }.items()
    }  # fmt: skip
    # The left half is red, the right one blue.
    row = bytes(RED) * (WIDTH // 2) + bytes(BLUE) * (WIDTH // 2)
    focal = 200.0
    began, count = time.monotonic(), 0
    while time.monotonic() - began < 60.0:
        stamp = ros.time(100.0 + SPEED * (time.monotonic() - began))
        state = JointState(name=NAMES, position=PANDA, velocity=[0.0] * 9, effort=[0.0] * 9)
        # By our own clock, which tests that do not read this one go by.
        state.header.stamp = ros.time(100.0 + time.monotonic() - began)
        publish["joint_states"](state)
        unit = Imu()
        unit.orientation.w = 1.0
        (unit.angular_velocity.x, unit.angular_velocity.y, unit.angular_velocity.z) = GYRO
        (unit.linear_acceleration.x, unit.linear_acceleration.y, unit.linear_acceleration.z) = FORCE
        publish["imu/data"](unit)
        clock = Clock()
        clock.clock = stamp
        publish["clock"](clock)
        if count % 5 == 0:
            info = CameraInfo(width=WIDTH, height=HEIGHT, distortion_model="plumb_bob")
            ros.calibrate(info, [focal, 0.0, WIDTH / 2, 0.0, focal, HEIGHT / 2, 0.0, 0.0, 1.0])
            publish["camera/color/camera_info"](info)
            picture = Image(width=WIDTH, height=HEIGHT, encoding="bgr8", step=3 * WIDTH)
            picture.data = _swapped(row) * HEIGHT
            publish["camera/color/image_raw"](picture)
            publish["camera/color/image_raw/compressed"](CompressedImage(format="png", data=_png(row * HEIGHT)))
            depth = Image(width=WIDTH, height=HEIGHT, encoding="16UC1", step=2 * WIDTH)
            depth.data = struct.pack("<H", 1500) * (WIDTH * HEIGHT)
            publish["camera/depth/image_raw"](depth)
            body = Odometry()
            body.pose.pose.position.x, body.pose.pose.orientation.w = 0.4, 1.0
            publish["tag/odom"](body)
            ros.transform(TransformStamped, stamp)
        count += 1
        ros.spin(0.01)


def hear(ros: Ros1 | Ros2) -> None:
    """Print the size, encoding and focal length of the arm's pictures."""
    from sensor_msgs.msg import CameraInfo, Image  # pyright: ignore[reportMissingImports]

    found: dict[str, str] = {}
    ros.subscribe(
        Image, "eye/image_raw", lambda m: found.update(color=f"{m.width}x{m.height} {m.encoding} {len(m.data)}")
    )
    ros.subscribe(
        Image, "eye/depth/image_raw", lambda m: found.update(depth=f"{m.width}x{m.height} {m.encoding} {len(m.data)}")
    )
    ros.subscribe(CameraInfo, "eye/camera_info", lambda m: found.update(info=f"{m.width} {ros.focal(m):.3f}"))
    end = time.monotonic() + 30.0
    while time.monotonic() < end and len(found) < 3:
        ros.spin(0.05)
    print(*(f"{name}: {text}" for name, text in sorted(found.items())), sep="; ")


def _swapped(row: bytes) -> bytes:
    return b"".join(row[i + 2 : i + 3] + row[i + 1 : i + 2] + row[i : i + 1] for i in range(0, len(row), 3))


def _png(pixels: bytes) -> bytes:
    """Return a PNG file of rows of colours."""
    rows = b"".join(b"\0" + pixels[i : i + 3 * WIDTH] for i in range(0, len(pixels), 3 * WIDTH))
    parts = (
        (b"IHDR", struct.pack(">IIBBBBB", WIDTH, HEIGHT, 8, 2, 0, 0, 0)),
        (b"IDAT", zlib.compress(rows)),
        (b"IEND", b""),
    )
    chunks = (
        struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data)) for kind, data in parts
    )
    return b"\x89PNG\r\n\x1a\n" + b"".join(chunks)


class Ros1:
    """rospy."""

    def __init__(self) -> None:
        import rospy  # pyright: ignore[reportMissingImports]
        from tf2_msgs.msg import TFMessage  # pyright: ignore[reportMissingImports]

        self._ros = rospy
        rospy.init_node("robot", disable_rostime=True)
        self._frames, self._message = self.publisher(TFMessage, "tf"), TFMessage

    def publisher(self, kind, topic):
        return self._ros.Publisher(f"/{topic}", kind, queue_size=10).publish

    def subscribe(self, kind, topic, callback) -> None:
        self._ros.Subscriber(f"/{topic}", kind, callback)

    def time(self, seconds: float):
        return self._ros.Time.from_sec(seconds)

    def calibrate(self, info, k) -> None:
        info.D, info.K = [0.0] * 5, k

    def focal(self, info) -> float:
        return info.K[0]

    def transform(self, kind, stamp) -> None:
        """Publish the frame of a tag on a table, which is at (1, 0, 0) in the map."""
        frames = []
        for parent, child, x in (("map", "table", 1.0), ("table", "tag_3", 0.25)):
            frame = kind()
            frame.header.frame_id, frame.child_frame_id, frame.header.stamp = parent, child, stamp
            frame.transform.translation.x, frame.transform.rotation.w = x, 1.0
            frames.append(frame)
        self._frames(self._message(frames))

    def spin(self, seconds: float) -> None:
        time.sleep(seconds)


class Ros2:
    """rclpy; its wheels have no messages of tf2."""

    def __init__(self) -> None:
        import rclpy  # pyright: ignore[reportMissingImports]

        rclpy.init()
        self._ros, self._node = rclpy, rclpy.create_node("robot")

    def publisher(self, kind, topic):
        return self._node.create_publisher(kind, topic, 10).publish

    def subscribe(self, kind, topic, callback) -> None:
        self._node.create_subscription(kind, topic, callback, 10)

    def time(self, seconds: float):
        from builtin_interfaces.msg import Time  # pyright: ignore[reportMissingImports]

        return Time(sec=int(seconds), nanosec=int(1e9 * (seconds % 1.0)))

    def calibrate(self, info, k) -> None:
        info.d, info.k = [0.0] * 5, k

    def focal(self, info) -> float:
        return info.k[0]

    def transform(self, kind, stamp) -> None:
        pass

    def spin(self, seconds: float) -> None:
        self._ros.spin_once(self._node, timeout_sec=seconds)


if __name__ == "__main__":
    main(sys.argv[1], "listen" in sys.argv)
