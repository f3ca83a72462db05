"""Recordings of ROS 1 and ROS 2 are read as the log of a robot."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from orbit_core.interfaces import ConfigurationError
from orbit_ros.recordings import read_recording

pytest.importorskip("rosbags", reason="the extra orbit-ros[rosbag] is not installed")
NAMES = ["elbow", "wrist"]


def written(path: Path, ros1: bool = False, states: bool = True, numbers: bool = False) -> Path:
    """Recording of half a second: states at 100 Hz, with joints in turned order, and commands at 50 Hz."""
    from rosbags.rosbag1 import Writer as Writer1
    from rosbags.rosbag2 import Writer as Writer2
    from rosbags.typesys import Stores, get_typestore

    store = get_typestore(Stores.ROS1_NOETIC if ros1 else Stores.ROS2_HUMBLE)
    types: dict[str, Any] = dict(store.types)
    time, header = types["builtin_interfaces/msg/Time"], types["std_msgs/msg/Header"]
    duration, point = types["builtin_interfaces/msg/Duration"], types["trajectory_msgs/msg/JointTrajectoryPoint"]
    encode = store.serialize_ros1 if ros1 else store.serialize_cdr
    sequence = {"seq": 0} if ros1 else {}

    def stamped(seconds: float) -> Any:
        return header(**sequence, stamp=time(int(seconds), round(1e9 * (seconds % 1.0))), frame_id="")

    writer = Writer1(path) if ros1 else Writer2(path, version=9)
    empty = np.zeros(0)
    with writer:
        commanded = "std_msgs/msg/Float64MultiArray" if numbers else "trajectory_msgs/msg/JointTrajectory"
        topics = {"/joint_states": "sensor_msgs/msg/JointState", "/command": commanded}
        connections = {topic: writer.add_connection(topic, kind, typestore=store) for topic, kind in topics.items()}
        for step in range(50):
            now = 100.0 + 0.01 * step
            if states:
                message = types["sensor_msgs/msg/JointState"](
                    header=stamped(now),
                    name=NAMES if step == 0 else NAMES[::-1],
                    position=np.array([0.01 * step, -0.02 * step])[:: 1 if step == 0 else -1].copy(),
                    velocity=np.array([1.0, -2.0])[:: 1 if step == 0 else -1].copy(),
                    effort=empty,
                )
                writer.write(connections["/joint_states"], round(1e9 * now), encode(message, message.__msgtype__))
            if step % 2 == 0:
                goal = np.array([0.01 * step + 0.1, -0.02 * step])
                if numbers:
                    layout = types["std_msgs/msg/MultiArrayLayout"](dim=[], data_offset=0)
                    message = types[commanded](layout=layout, data=goal)
                else:
                    message = types[commanded](
                        header=stamped(0.0),
                        joint_names=NAMES[:1],
                        points=[point(goal[:1], empty, empty, empty, duration(0, 0))],
                    )
                writer.write(connections["/command"], round(1e9 * now), encode(message, message.__msgtype__))
    return path


@pytest.mark.parametrize(("ros1", "numbers"), [(False, False), (False, True), (True, False)])
def test_a_recording_is_the_log_of_a_robot(ros1: bool, numbers: bool, tmp_path: Path) -> None:
    log = read_recording(written(tmp_path / ("one.bag" if ros1 else "two"), ros1, numbers=numbers))
    assert log.joints == ("elbow", "wrist")
    assert log.duration == pytest.approx(0.49, abs=1e-6)
    assert log.position[:, 1] == pytest.approx(-0.02 * np.arange(50))
    assert log.velocity[:, 0] == pytest.approx(1.0)
    assert log.target[:48, 0] == pytest.approx(0.1 + 0.01 * np.arange(48), abs=1e-6)
    assert log.target[:48, 1] == pytest.approx(-0.02 * np.arange(48) if numbers else np.zeros(48), abs=1e-6)


def test_recordings_without_joint_states_and_files_that_are_none_are_refused(tmp_path: Path) -> None:
    with pytest.raises(ConfigurationError, match="holds no sensor_msgs/msg/JointState: it has /command"):
        read_recording(written(tmp_path / "bag", states=False))
    (tmp_path / "none.bag").write_bytes(b"nothing")
    (tmp_path / "folder").mkdir()
    for path in (tmp_path / "none.bag", tmp_path / "folder"):
        with pytest.raises(ConfigurationError, match="is no recording that rosbags reads"):
            read_recording(path)
