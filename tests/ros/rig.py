"""Domains and masters that tests have for themselves, and servers of the arm of three joints."""

from __future__ import annotations

import itertools
import os
import shutil
import socket
import subprocess
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from orbit_deploy.computer import ComputerSettings, RobotComputer
from orbit_deploy.follower import FollowerSettings
from orbit_deploy.link import bridge
from tests.deploy.rig import eventually, hardware

ROS1_PACKAGES = Path("/usr/lib/python3/dist-packages/rospy")
_domains = itertools.count()


def free_domain() -> int:
    """Return the number of a DDS domain that tests of other processes are unlikely to have."""
    return 20 + (os.getpid() * 7 + next(_domains)) % 200


def skip_without_ros1() -> None:
    """Skip the test where ROS 1 is not installed."""
    if not ROS1_PACKAGES.is_dir() or shutil.which("rosmaster") is None:
        pytest.skip("capability 'ROS 1' is not installed: apt-get install python3-rospy python3-rosmaster ...")


@contextmanager
def ros1_master() -> Iterator[int]:
    """Run a real master of ROS 1, and yield its port; this process is a node of one master only."""
    from orbit_ros.ros1 import Ros1Node

    with socket.socket() as found:
        found.bind(("127.0.0.1", 0))
        port = found.getsockname()[1]
    if Ros1Node._master:
        port = int(Ros1Node._master.rpartition(":")[2])
    with subprocess.Popen(["rosmaster", "--core", "-p", str(port)], stdout=subprocess.DEVNULL) as master:
        try:
            assert eventually(lambda: listens(port), 20.0)
            yield port
        finally:
            master.terminate()


def listens(port: int) -> bool:
    """Return True if a server listens at this port of loopback."""
    with socket.socket() as tried:
        return tried.connect_ex(("127.0.0.1", port)) == 0


@contextmanager
def served(address: str) -> Iterator[RobotComputer]:
    """The arm's computer, whose loop runs in a thread, behind a bridge of ROS."""
    # A shared machine may hold up threads for long, and the loop is slower than a robot's for that reason.
    motion, settings = FollowerSettings(watchdog=0.5), ComputerSettings(state_rate=100.0)
    computer = RobotComputer(hardware(), motion, settings)
    server = bridge(address.partition("://")[0]).serve(computer, address)
    thread = threading.Thread(target=computer.run, daemon=True)
    thread.start()
    try:
        yield computer
    finally:
        computer.end()
        thread.join(5.0)
        server.close()
        computer.hardware.close()
