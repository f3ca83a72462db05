"""Domains and masters that tests have for themselves, and servers of the arm of three joints."""

from __future__ import annotations

import itertools
import os
import threading
from collections.abc import Iterator
from contextlib import contextmanager

from orbit_deploy.computer import ComputerSettings, RobotComputer
from orbit_deploy.follower import FollowerSettings
from orbit_deploy.link import bridge
from tests.deploy.rig import hardware

_domains = itertools.count()


def free_domain() -> int:
    """Return the number of a DDS domain that tests of other processes are unlikely to have."""
    return 20 + (os.getpid() * 7 + next(_domains)) % 200


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
