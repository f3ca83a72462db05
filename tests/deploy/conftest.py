"""Fixtures of a robot's computer behind ZeroMQ, and of a client's session with it."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING

import pytest

if TYPE_CHECKING:
    from orbit_deploy.computer import RobotComputer
    from orbit_zmq.client import ZmqLink

# Imports are late: most tests of this folder need no ZeroMQ.


@pytest.fixture(scope="module")
def robot() -> Iterator[tuple[RobotComputer, str]]:
    """A robot's computer and its address."""
    from tests.deploy.rig import served

    with served() as robot:
        yield robot


@pytest.fixture
def link(robot: tuple[RobotComputer, str]) -> Iterator[ZmqLink]:
    """Session with the robot, once the last test's client has left."""
    from orbit_deploy.link import connect
    from orbit_zmq.client import ZmqLink
    from tests.deploy.rig import PERIOD, eventually

    assert eventually(lambda: not robot[0].client)
    link = connect(robot[1], PERIOD)
    assert isinstance(link, ZmqLink)
    yield link
    link.close()
