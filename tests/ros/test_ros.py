"""Robots over ROS: a policy's commands reach a robot, and programs of ROS command a simulated one."""

from __future__ import annotations

import logging
import os
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from logging.handlers import RotatingFileHandler
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("cyclonedds", reason="ROS over DDS needs cyclonedds: pip install orbit-ros")

from orbit_core.interfaces import ConfigurationError
from orbit_deploy.link import RobotFaultError, RobotLinkError, connect
from orbit_ros import hardware as hardware_module
from orbit_ros import topics
from orbit_ros.body import body_of, odometry
from orbit_ros.dds import Ros2Node
from orbit_ros.messages import (
    Empty,
    Float64MultiArray,
    Header,
    Image,
    JointState,
    JointTrajectory,
    JointTrajectoryPoint,
    String,
    TFMessage,
    Time,
    duration_of,
    time_of,
)
from tests.deploy.rig import eventually
from tests.ros.rig import ROS1_PACKAGES, free_domain, ros1_master, served, skip_without_ros1

# Python of an environment with `ros-rclpy[fastrtps]` and its messages from the registry, for this test only
ROS2_PYTHON = os.environ.get("ORBIT_ROS2_PYTHON", "")


@pytest.fixture(scope="module", params=["ros2", "ros1"])
def address(request: pytest.FixtureRequest) -> Iterator[str]:
    """Address of a served arm, over both versions of ROS."""
    if request.param == "ros2":
        host = f"ros2://127.0.0.1:{free_domain()}/arm"
        with served(host):
            yield host
        return
    skip_without_ros1()
    with ros1_master() as port:
        host = f"ros1://127.0.0.1:{port}/arm"
        with served(host):
            yield host


@pytest.mark.parametrize("command", ["trajectory", "positions"])
def test_a_robot_of_ros_follows_our_commands(address: str, command: str) -> None:
    target = {"trajectory": 0.15, "positions": -0.15}[command]
    link = connect(f"{address}?command={command}", 0.02)
    try:
        assert link.description.joints == ["joint0", "joint1", "joint2"]

        def followed() -> bool:
            link.send([target, 0.0, 0.0], [0.0] * 3, [0.0] * 3)
            return abs(link.state().positions[0] - target) < 0.02

        assert eventually(followed, 15.0)
    finally:
        link.close()
    time.sleep(0.6)  # until the robot lets the next client command


def test_ros_leaves_the_programs_own_log_alone(address: str) -> None:
    root = logging.getLogger()
    assert root.level == logging.WARNING
    assert not any(isinstance(handler, RotatingFileHandler) for handler in root.handlers)


def test_limits_are_held_before_a_command_leaves(address: str) -> None:
    link = connect(address, 0.02)
    try:
        link.send([float("nan"), 0.0, 0.0], [0.0] * 3, [0.0] * 3)

        def refused() -> bool:
            try:
                link.state()
            except RobotFaultError as error:
                return "nan" in str(error)
            return False

        assert eventually(refused)
    finally:
        link.close()
    time.sleep(0.6)


@pytest.fixture(scope="module")
def domain() -> Iterator[int]:
    """DDS domain of a served arm that tests command as programs of ROS do."""
    number = free_domain()
    with served(f"ros2://127.0.0.1:{number}"):
        yield number


class Program:
    """Program of ROS that commands the arm."""

    def __init__(self, domain: int) -> None:
        self.node = Ros2Node(domain)
        self.states: list[JointState] = []
        self.faults: list[str] = []
        self.node.subscribe(topics.JOINT_STATES, JointState, lambda message, _: self.states.append(message))
        self.node.subscribe(topics.FAULTS, String, lambda message, _: self.faults.append(message.data))
        self.trajectory = self.node.advertise(topics.COMMANDS["trajectory"], JointTrajectory)
        self.positions = self.node.advertise(topics.COMMANDS["positions"], Float64MultiArray)
        self.clear = self.node.advertise(topics.CLEAR, Empty)
        assert eventually(lambda: len(self.states) > 0)
        # Discovery of the other direction follows at once.
        time.sleep(0.3)

    @property
    def where(self) -> list[float]:
        return list(self.states[-1].position)


@pytest.fixture
def program(domain: int) -> Iterator[Program]:
    made = Program(domain)
    yield made
    made.clear(Empty())
    time.sleep(0.6)
    made.node.close()


def test_a_trajectory_of_some_joints_moves_these_only(program: Program) -> None:
    before = program.where
    points = [JointTrajectoryPoint([0.1], time_from_start=duration_of(0.2)),
              JointTrajectoryPoint([0.25], time_from_start=duration_of(0.5))]  # fmt: skip
    program.trajectory(JointTrajectory(joint_names=["joint1"], points=points))
    assert eventually(lambda: abs(program.where[1] - 0.25) < 0.02, 10.0)
    assert abs(program.where[0] - before[0]) < 0.02
    assert abs(program.where[2] - before[2]) < 0.02


def test_an_array_of_positions_is_held_until_the_robot_is_there(program: Program) -> None:
    program.positions(Float64MultiArray(data=[0.1, 0.1, 0.1]))
    assert eventually(lambda: np.allclose(program.where, 0.1, atol=0.02), 10.0)


def test_commands_for_other_joints_are_faults_that_name_them(program: Program) -> None:
    program.trajectory(JointTrajectory(joint_names=["elbow"], points=[JointTrajectoryPoint([0.1])]))
    program.positions(Float64MultiArray(data=[0.1]))
    assert eventually(lambda: any("elbow" in fault for fault in program.faults))
    assert eventually(lambda: any("1 numbers for 3 joints" in fault for fault in program.faults))


def test_a_second_publisher_is_ignored_with_a_fault(domain: int, program: Program) -> None:
    other = Program(domain)

    def both() -> bool:
        program.positions(Float64MultiArray(data=[0.1, 0.1, 0.1]))
        other.positions(Float64MultiArray(data=[-0.4, 0.1, 0.1]))
        return any(fault.startswith("busy") for fault in program.faults)

    assert eventually(both)
    assert program.where[0] > -0.05
    other.node.close()


def test_the_cube_has_a_frame_and_an_odometry(domain: int) -> None:
    node, frames = Ros2Node(domain), []
    node.subscribe(topics.TF, TFMessage, lambda message, _: frames.extend(message.transforms))
    assert eventually(lambda: len(frames) > 0)
    assert frames[0].child_frame_id == "cube"
    assert abs(frames[0].transform.translation.x - 1.5) < 1e-3
    node.close()


def test_odometry_states_twists_in_the_bodys_axes() -> None:
    half = 0.5**0.5
    body = [1.0, 2.0, 3.0, half, 0.0, 0.0, half, 1.0, 0.0, 0.0, 0.0, 0.0, 0.5]
    message = odometry(body, Header(), "base")
    assert abs(message.twist.twist.linear.y + 1.0) < 1e-12  # facing left, forward is to the right
    np.testing.assert_allclose(body_of(message), body, atol=1e-12)


def test_a_picture_keeps_its_bytes() -> None:
    data = bytes(range(240)) * 3
    picture = Image(Header(Time(3, 4), "camera"), 12, 20, "rgb8", 0, 60, data)
    for version in (False, True):
        read = Image.deserialize(picture.serialize(use_version_2=version))
        assert (read.header, read.height, read.width, read.encoding) == (picture.header, 12, 20, "rgb8")
        assert read.step == 60
        assert read.data == data


def test_a_robot_that_is_not_there_or_another_machine_is_one_clear_error(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(hardware_module, "_FOUND", 0.1)
    with pytest.raises(RobotLinkError, match="nobody publishes joints of franka_panda"):
        connect(f"ros2://127.0.0.1:{free_domain()}?robot=franka_panda", 0.02)
    with pytest.raises(ConfigurationError, match="trusted=yes"):
        connect("ros2://192.168.1.9", 0.02)
    with pytest.raises(ConfigurationError, match="unknown options robots"):
        connect("ros2://127.0.0.1?robots=x", 0.02)
    with pytest.raises(ConfigurationError, match="from 0 to 232"):
        connect("ros2://127.0.0.1:5555?robot=franka_panda", 0.02)
    if ROS1_PACKAGES.is_dir():
        with pytest.raises(RobotLinkError, match="no ROS master"):
            connect("ros1://127.0.0.1:1?robot=franka_panda", 0.02)


@pytest.mark.skipif(not ROS2_PYTHON, reason="capability 'ROS 2' (rclpy) is not named by ORBIT_ROS2_PYTHON")
def test_a_program_of_the_real_ros_2_moves_the_arm(domain: int, tmp_path: Path) -> None:
    environment = {"ROS_DOMAIN_ID": str(domain), "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST", "PATH": "/usr/bin:/bin",
                   "HOME": str(tmp_path)}  # fmt: skip
    script = Path(__file__).with_name("ros2_program.py")
    ended = subprocess.run([ROS2_PYTHON, str(script)], env=environment, capture_output=True, text=True, timeout=60.0)
    assert ended.returncode == 0, ended.stderr[-2000:]
    print(ended.stdout, file=sys.stderr)
    assert "joint2 reached" in ended.stdout


def publish_states(node: Ros2Node, spoil: Callable[[JointState], None]) -> tuple[threading.Event, threading.Event]:
    """Publish states of the arm at 100 Hz as its robot, spoilt from the first event on, until the second one."""
    publish, spoilt, ended = node.advertise(topics.JOINT_STATES, JointState), threading.Event(), threading.Event()

    def run() -> None:
        count = 0
        while not ended.wait(0.01):
            names = [f"panda_joint{i + 1}" for i in range(7)] + ["panda_finger_joint1", "panda_finger_joint2"]
            state = JointState(Header(time_of(10**10 + 10**7 * count)), names, [0.0] * 9, [0.0] * 9, [0.0] * 9)
            state.position = [0.0, -0.5, 0.0, -2.8, 0.0, 3.0, 0.7, 0.02, 0.02]
            if spoilt.is_set():
                spoil(state)
            publish(state)
            count += 1

    threading.Thread(target=run, daemon=True).start()
    return spoilt, ended


def _not_a_number(state: JointState) -> None:
    state.velocity = [0.0, float("nan"), *[0.0] * 7]


def _jumped(state: JointState) -> None:
    state.header.stamp = time_of(10**9)


def _shortened(state: JointState) -> None:
    state.position = [0.0] * 3


def _silenced(state: JointState) -> None:
    # A robot that goes on about joints which are not the arm's says nothing of the arm.
    state.name = ["wheel"] * 9


@pytest.mark.parametrize(
    ("spoil", "words"),
    [
        (_not_a_number, "no finite number for joint panda_joint2"),
        (_jumped, "joint_states' jumped by -"),
        (_shortened, "has 3 numbers of position for 9 names"),
        (_silenced, "no joint states on 'joint_states' for"),
    ],
    ids=["nan", "jump", "short", "silent"],
)
def test_a_robot_of_ros_that_sends_no_numbers_or_jumps_in_time_is_one_error(
    spoil: Callable[[JointState], None], words: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    if spoil is _silenced:
        monkeypatch.setattr(hardware_module, "_LOST", 2.0)
    number = free_domain()
    node = Ros2Node(number)
    spoilt, ended = publish_states(node, spoil)
    link = connect(f"ros2://127.0.0.1:{number}?robot=franka_panda", 0.02)
    spoilt.set()
    try:
        found: list[str] = []

        def failed() -> bool:
            try:
                link.state()
            except (RobotFaultError, RobotLinkError) as error:
                found.append(str(error))
            return bool(found)

        assert eventually(failed, 10.0)
        assert words in found[0]
    finally:
        link.close()
        ended.set()
        node.close()


def test_a_robot_whose_description_is_of_another_version_is_one_error() -> None:
    number = free_domain()
    node = Ros2Node(number)
    describe = node.advertise(topics.DESCRIPTION, String, latched=True)
    describe(String('{"model": "arm", "joints": [], "wings": 2}'))
    with pytest.raises(RobotLinkError, match=r"cannot be read: .*wings"):
        connect(f"ros2://127.0.0.1:{number}", 0.02)
    node.close()
