"""Motion of a robot from recordings of ROS 1 and ROS 2 (rosbag), read by ``rosbags`` without a ROS installation."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from orbit_core.installing import install_command
from orbit_core.interfaces import ConfigurationError
from orbit_deploy.description import FloatArray
from orbit_deploy.motion_log import MotionLog, motion_log

_STATES = "sensor_msgs/msg/JointState"
_TRAJECTORY, _NUMBERS = "trajectory_msgs/msg/JointTrajectory", "std_msgs/msg/Float64MultiArray"


def read_recording(path: Path) -> MotionLog:
    """Read a recording: measured joints from its ``JointState`` topic, targets from its topic of commands.

    Commands are ``JointTrajectory`` or ``Float64MultiArray`` of all joints; targets between two of them are on a line,
    as controllers of trajectories move. Of several topics of a kind, the one with the most messages counts.

    Args:
        path: folder of a ROS 2 recording, or a ``.bag``, ``.mcap`` or ``.db3`` file.

    Raises:
        ConfigurationError: it is no recording, or holds no joint states.
    """
    try:
        from rosbags.highlevel import AnyReader, AnyReaderError
        from rosbags.typesys import Stores, get_typestore
    except ImportError:
        raise ConfigurationError(f"recordings of ROS need rosbags: {install_command('orbit-ros[rosbag]')}") from None
    try:
        with AnyReader([path], default_typestore=get_typestore(Stores.ROS2_HUMBLE)) as reader:
            states, commands = _busiest(reader, (_STATES,)), _busiest(reader, (_TRAJECTORY, _NUMBERS))
            if states is None or not states.msgcount:
                raise ConfigurationError(f"{path} holds no {_STATES}: it has {', '.join(sorted(reader.topics))}")
            joints, times, columns = _states(_messages(reader, states), path)
            targets = [] if commands is None else list(_targets(_messages(reader, commands), joints))
    except (AnyReaderError, OSError, KeyError) as error:
        raise ConfigurationError(f"{path} is no recording that rosbags reads: {error}") from None
    if targets:
        at, given = np.array([when for when, _ in targets]), np.array([values for _, values in targets])
        # Joints that no command names yet are where they were at first.
        given = np.where(np.isnan(given), columns["position"][0], given)
        columns["target"] = np.stack([np.interp(times, at, given[:, column]) for column in range(len(joints))], 1)
    return motion_log(joints, times, columns, path.name)


def _busiest(reader: Any, kinds: tuple[str, ...]) -> Any:
    """Return the connection of one of these types with the most messages, or None."""
    found = [each for each in reader.connections if each.msgtype in kinds]
    return max(found, key=lambda each: each.msgcount, default=None)


def _messages(reader: Any, connection: Any) -> Iterator[tuple[float, Any]]:
    """Yield times of arrival, s, and messages."""
    for each, stamp, data in reader.messages(connections=[connection]):
        yield 1e-9 * stamp, reader.deserialize(data, each.msgtype)


def _states(
    messages: Iterator[tuple[float, Any]], path: Path
) -> tuple[tuple[str, ...], FloatArray, dict[str, FloatArray]]:
    """Return joints, times (T,) of the states and their columns (T, J)."""
    joints: tuple[str, ...] = ()
    rows: dict[str, list[FloatArray]] = {"position": [], "velocity": [], "effort": []}
    times: list[float] = []
    for arrived, message in messages:
        names = tuple(message.name)
        joints = joints or names
        if set(names) != set(joints):
            raise ConfigurationError(f"{path} holds states of {', '.join(joints)} and of {', '.join(names)}")
        order = [names.index(name) for name in joints]
        stamp = message.header.stamp.sec + 1e-9 * message.header.stamp.nanosec
        # Stamps are those of the measurement; publishers that leave them out are taken by their arrival.
        when = stamp or arrived
        if times and when <= times[-1]:
            continue
        times.append(when)
        for kind, field in (("position", message.position), ("velocity", message.velocity), ("effort", message.effort)):
            values = np.asarray(field, np.float64)
            rows[kind].append(values[order] if len(values) == len(names) else np.zeros(len(joints)))
    columns = {kind: np.array(values) for kind, values in rows.items()}
    return joints, np.array(times), columns


def _targets(messages: Iterator[tuple[float, Any]], joints: tuple[str, ...]) -> Iterator[tuple[float, FloatArray]]:
    """Yield times and target positions (J,); NaN for joints that no command has named yet."""
    now = np.full(len(joints), np.nan)
    for arrived, message in messages:
        if not hasattr(message, "points"):
            values = np.asarray(message.data, np.float64)
            if len(values) == len(joints):
                now = values
                yield arrived, now
            continue
        stamp = message.header.stamp.sec + 1e-9 * message.header.stamp.nanosec
        columns = [joints.index(name) for name in message.joint_names if name in joints]
        places = [place for place, name in enumerate(message.joint_names) if name in joints]
        for point in message.points:
            now = now.copy()
            now[columns] = np.asarray(point.positions, np.float64)[places]
            after = point.time_from_start.sec + 1e-9 * point.time_from_start.nanosec
            yield (stamp or arrived) + after, now
