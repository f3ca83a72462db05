"""A robot behind rosbridge: the arm's computer serves ROS 2, a real rosbridge server carries its topics to us."""

from __future__ import annotations

import math
import socket
import threading
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("cyclonedds", reason="ROS over DDS needs cyclonedds: pip install orbit-ros")
pytest.importorskip("roslibpy", reason="rosbridge needs roslibpy: pip install orbit-ros[rosbridge]")

from orbit_core.interfaces import ConfigurationError
from orbit_deploy.computer import RobotComputer
from orbit_deploy.link import RobotFaultError, RobotLink, RobotLinkError, connect
from orbit_ros.messages import (
    Empty,
    Header,
    Image,
    JointState,
    JointTrajectory,
    JointTrajectoryPoint,
    TFMessage,
    Time,
    TransformStamped,
    duration_of,
)
from orbit_ros.rosbridge import RosbridgeNode, from_json, to_json
from tests.deploy.rig import eventually
from tests.ros.rig import free_domain, served
from tests.ros.rosbridge_server import missing, rosbridge


@pytest.fixture(scope="module")
def robot(tmp_path_factory: pytest.TempPathFactory) -> Iterator[tuple[RobotComputer, str]]:
    """The arm's computer, and its address over rosbridge."""
    if missing():
        pytest.skip(missing())
    domain = free_domain()
    with (
        served(f"ros2://127.0.0.1:{domain}") as computer,
        rosbridge(domain, tmp_path_factory.mktemp("rosbridge")) as port,
    ):
        yield computer, f"rosbridge://127.0.0.1:{port}?ros=2"


@pytest.mark.parametrize("command", ["trajectory", "positions"])
def test_a_robot_behind_rosbridge_follows_our_commands(robot: tuple[RobotComputer, str], command: str) -> None:
    target = {"trajectory": 0.15, "positions": -0.15}[command]
    link = connect(f"{robot[1]}&command={command}", 0.02)
    try:
        assert link.description.joints == ["joint0", "joint1", "joint2"]
        assert link.description.objects == ["cube"]

        def followed() -> bool:
            link.send([target, 0.0, 0.0], [0.0] * 3, [0.0] * 3)
            return abs(link.state().positions[0] - target) < 0.02

        assert eventually(followed, 15.0)
    finally:
        link.close()
    assert eventually(lambda: robot[0].follower.limiter.at_rest)


def test_limits_are_held_before_a_command_leaves_for_rosbridge(robot: tuple[RobotComputer, str]) -> None:
    link = connect(robot[1], 0.02)
    try:
        link.send([math.nan, 0.0, 0.0], [0.0] * 3, [0.0] * 3)

        def refused() -> bool:
            try:
                link.state()
            except RobotFaultError as error:
                return "nan" in str(error)
            return False

        assert eventually(refused)
    finally:
        link.close()


def test_a_rosbridge_server_that_goes_in_motion_is_one_error_and_the_robot_rests(tmp_path: Path) -> None:
    if missing():
        pytest.skip(missing())
    domain = free_domain()
    with served(f"ros2://127.0.0.1:{domain}") as computer:
        with rosbridge(domain, tmp_path) as port:
            link = connect(f"rosbridge://127.0.0.1:{port}?ros=2", 0.02)
            assert eventually(lambda: _moves(link, computer))
        with pytest.raises(RobotLinkError, match=r"has failed: .*(is gone|no joint states)"):
            command(link, 10.0)
        assert eventually(lambda: computer.follower.limiter.at_rest)
        link.close()


def command(link: RobotLink, seconds: float) -> None:
    """Command one target again and again."""
    end = time.monotonic() + seconds
    while time.monotonic() < end:
        link.send([0.4, 0.0, 0.0], [0.0] * 3, [0.0] * 3)
        time.sleep(0.02)
        link.state()


def _moves(link: RobotLink, computer: RobotComputer) -> bool:
    link.send([0.3, 0.0, 0.0], [0.0] * 3, [0.0] * 3)
    return abs(computer.follower.limiter.velocity[0]) > 0.01


def test_what_a_server_refuses_is_the_one_error(tmp_path: Path) -> None:
    if missing():
        pytest.skip(missing())
    # The server of the tests has no messages of tf2.
    with rosbridge(free_domain(), tmp_path) as port:
        node = RosbridgeNode("127.0.0.1", port, version=2)
        node.subscribe("tf", TFMessage, lambda message, source: None)

        def refused() -> bool:
            try:
                node.check()
            except RobotLinkError as error:
                return "refuses: " in str(error) and "tf2_msgs" in str(error)
            return False

        assert eventually(refused)
        node.close()


def test_no_server_or_another_one_is_one_clear_error() -> None:
    with pytest.raises(RobotLinkError, match=r"no rosbridge server at 127\.0\.0\.1:1"):
        connect("rosbridge://127.0.0.1:1?robot=franka_panda", 0.02)
    with pytest.raises(ConfigurationError, match="1 or 2, not '3'"):
        connect("rosbridge://127.0.0.1:1?ros=3", 0.02)
    with pytest.raises(ConfigurationError, match="trusted=yes"):
        connect("rosbridge://192.168.1.9", 0.02)


def test_a_server_that_speaks_something_else_is_one_clear_error(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("orbit_ros.rosbridge._CONNECTED", 0.3)
    with socket.create_server(("127.0.0.1", 0)) as server:
        threading.Thread(target=_accept, args=(server,), daemon=True).start()
        with pytest.raises(RobotLinkError, match="does not answer as rosbridge does"):
            connect(f"rosbridge://127.0.0.1:{server.getsockname()[1]}", 0.02)


def _accept(server: socket.socket) -> None:
    kept = []
    while True:
        try:
            kept.append(server.accept())
        except OSError:
            return


@pytest.mark.parametrize("ros1", [False, True])
def test_messages_return_from_json_as_they_were(ros1: bool) -> None:
    header = Header(Time(3, 4), "world")
    points = [JointTrajectoryPoint([0.5], time_from_start=duration_of(1.5))]
    for message in (
        JointState(header, ["a"], [1.0], [], [2.0]),
        JointTrajectory(header, ["a"], points),
        TFMessage([TransformStamped(header, "base")]),
        Image(header, 1, 2, "rgb8", 0, 6, bytes(range(6))),
        Empty(),
    ):
        assert from_json(to_json(message, ros1), type(message)) == message
    stamp = to_json(header, ros1)["stamp"]
    assert stamp == ({"secs": 3, "nsecs": 4} if ros1 else {"sec": 3, "nanosec": 4})


def test_numbers_that_are_not_finite_are_null_in_json() -> None:
    written = to_json(JointState(position=[math.nan, math.inf, 1.0]), ros1=False)
    assert written["position"] == [None, None, 1.0]
    np.testing.assert_array_equal(from_json(written, JointState).position, [math.nan, math.nan, 1.0])
