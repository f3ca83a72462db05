"""Time a robot's computer and its bridge: cycles of its loop, round trips of commands, messages of ROS there and back.

Run it on a machine without other work::

    python benchmarks/robot_timing.py robot 60                      # ZeroMQ: a simulated Panda in a process, 50 Hz
    python benchmarks/robot_timing.py echo ros2://127.0.0.1:3 20    # ROS: JointState to a second process and back
    python benchmarks/robot_timing.py echo ros1://127.0.0.1:11311 20
"""

from __future__ import annotations

import math
import signal
import subprocess
import sys
import time
from urllib.parse import urlsplit

from orbit_deploy.clocks import Latencies
from orbit_deploy.link import RobotLink, connect
from orbit_deploy.realtime import prioritized
from orbit_ros.messages import Header, JointState, Time
from orbit_ros.node import RosNode

_PERIOD = 0.02
_JOINTS = 12


def time_robot(seconds: float) -> None:
    """Command 0.6 rad at 1 Hz, then say nothing more at 1.9 rad/s, and print what robot and client measured."""
    code = "from orbit_core.cli import main; raise SystemExit(main())"
    words = ["robot", "franka_panda", "--backend", "mujoco", "--port", "0", "--realtime"]
    with subprocess.Popen([sys.executable, "-uc", code, *words], stdout=subprocess.PIPE, text=True) as robot:
        try:
            assert robot.stdout is not None
            address = next(line for line in robot.stdout if " at " in line).split(" at ")[1].split()[0]
            _swing(connect(address, _PERIOD), seconds)
        finally:
            robot.send_signal(signal.SIGINT)
            print(robot.communicate()[0], flush=True)


def _swing(link: RobotLink, seconds: float) -> None:
    """Command one joint, then nothing, and print latencies and the way of the stop."""
    begin, due = list(link.state().positions), link.now()
    # The last command comes at the greatest speed.
    for step in range(round((math.floor(seconds) + 0.25) / _PERIOD)):
        turned = 0.3 * (1.0 - math.cos(2.0 * math.pi * step * _PERIOD))
        link.send([begin[0] + turned, *begin[1:]], [0.0] * 9, [0.0] * 9)
        due += _PERIOD
        link.wait(due)
        link.state()
    stop = _time_stop(link)
    print(f"round trip of a command: {link.round_trips} (p50/p99/p99.9); a state is {link.ages} old")
    print(f"stop: {stop}", flush=True)
    link.close()


def _time_stop(link: RobotLink) -> str:
    """Say when the joints, that have no command any more, began to brake, and when they rested."""
    sent, began = time.monotonic(), math.nan
    while time.monotonic() - sent < 2.0:
        state = link.state()
        now = time.monotonic() - sent
        if math.isnan(began) and state.mode in ("stopping", "holding"):
            began = now
        if state.mode == "holding":
            return f"begins {1e3 * began:.0f} ms and ends {1e3 * now:.0f} ms after the next command was due"
        time.sleep(0.001)
    return "none within 2 s"


def node_of(address: str) -> RosNode:
    """Return a node at an address of ROS."""
    parts = urlsplit(address)
    if parts.scheme == "ros1":
        from orbit_ros.ros1 import Ros1Node

        return Ros1Node(parts.hostname or "", parts.port or 11311)
    from orbit_ros.dds import Ros2Node

    return Ros2Node(parts.port or 0, parts.hostname or "")


def answer(address: str) -> None:
    """Send each joint state back."""
    node = node_of(address)
    back = node.advertise("timing/back", JointState)
    node.subscribe("timing/there", JointState, lambda message, _: back(message))
    print("ready", flush=True)
    while True:
        time.sleep(1.0)


def time_echo(address: str, seconds: float) -> None:
    """Print round trips of joint states at 100 Hz, and how many were lost."""
    with subprocess.Popen([sys.executable, __file__, "answer", address], stdout=subprocess.PIPE, text=True) as other:
        assert other.stdout is not None
        other.stdout.readline()
        node, trips, numbers = node_of(address), Latencies(), [0.0] * _JOINTS

        def take(message: JointState, _: str) -> None:
            sent = message.header.stamp.sec * 1_000_000_000 + message.header.stamp.nanosec
            trips.add(1e-9 * (time.monotonic_ns() - sent))

        node.subscribe("timing/back", JointState, take)
        publish = node.advertise("timing/there", JointState)
        time.sleep(2.0)
        for _ in range(round(100 * seconds)):
            stamp = Time(*divmod(time.monotonic_ns(), 1_000_000_000))
            publish(JointState(Header(stamp), [f"joint{i}" for i in range(_JOINTS)], numbers, numbers, numbers))
            time.sleep(0.01)
        time.sleep(0.5)
        print(f"there and back: {trips} (p50/p99/p99.9), {round(100 * seconds) - len(trips)} lost")
        node.close()
        other.kill()


if __name__ == "__main__":
    with prioritized():
        if sys.argv[1] == "robot":
            time_robot(float(sys.argv[2]))
        elif sys.argv[1] == "echo":
            time_echo(sys.argv[2], float(sys.argv[3]))
        else:
            answer(sys.argv[2])
