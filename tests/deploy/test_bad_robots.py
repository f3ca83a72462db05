"""Robots that send no numbers, or whose clock jumps: one clear error, and the robot rests."""

from __future__ import annotations

import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace

import numpy as np
import pytest

from orbit_core.interfaces import ConfigurationError
from orbit_deploy.clocks import RobotClock, StampWatch
from orbit_deploy.computer import RobotComputer
from orbit_deploy.follower import FollowerSettings, JointTargets
from orbit_deploy.hardware import Measurement, RobotHardware
from orbit_deploy.link import RobotFaultError, RobotLink, RobotLinkError, connect
from orbit_deploy.messages import Mode, RobotState
from orbit_zmq.server import ZmqServer
from tests.deploy.rig import PERIOD, description, eventually

NAN = float("nan")


class Follower(RobotHardware):
    """Robot whose joints are where they are sent, and whose measurement can be spoilt."""

    def __init__(self) -> None:
        self.description = description()
        self.positions, self.spoilt = np.zeros(3), Measurement(np.zeros(3), np.zeros(3), np.zeros(3))

    def read(self) -> Measurement:
        return replace(self.spoilt, positions=self.positions + self.spoilt.positions)

    def drive(self, targets: JointTargets) -> None:
        self.positions = targets.positions


class JumpingClock(RobotClock):
    """Clock that can be set ahead or back."""

    def now(self) -> int:
        return super().now() + getattr(self, "jumped", 0)

    def jump(self, seconds: float) -> None:
        object.__setattr__(self, "jumped", round(1e9 * seconds))


@contextmanager
def served() -> Iterator[tuple[RobotComputer, Follower, JumpingClock, RobotLink]]:
    """A robot behind ZeroMQ that a client commands to move."""
    hardware, clock = Follower(), JumpingClock(offset=1000.0)
    computer = RobotComputer(hardware, FollowerSettings(watchdog=0.3), clock=clock)
    server = ZmqServer(computer, "zmq://127.0.0.1:0")
    thread = threading.Thread(target=computer.run, daemon=True)
    thread.start()
    link = connect(server.address, PERIOD)
    try:
        assert eventually(lambda: _moves(link, computer))
        yield computer, hardware, clock, link
        assert eventually(lambda: computer.follower.mode in (Mode.HOLDING, Mode.FAULT))
        assert computer.follower.limiter.at_rest
    finally:
        link.close()
        computer.end()
        thread.join(5.0)
        server.close()


def _moves(link: RobotLink, computer: RobotComputer) -> bool:
    link.send([1.0, 0.0, 0.0], [0.0] * 3, [0.0] * 3)
    return computer.follower.limiter.velocity[0] > 0.01


def command(link: RobotLink, seconds: float = 5.0) -> None:
    """Command one target again and again."""
    end = time.monotonic() + seconds
    while time.monotonic() < end:
        link.send([1.0, 0.0, 0.0], [0.0] * 3, [0.0] * 3)
        link.wait(link.now() + PERIOD)
        link.state()


@pytest.mark.parametrize("row", ["positions", "velocities", "efforts"])
def test_a_robot_that_measures_nan_is_one_fault_that_names_the_joint(row: str) -> None:
    with served() as (_, hardware, _, link):
        hardware.spoilt = replace(hardware.spoilt, **{row: np.array([0.0, NAN, 0.0])})
        with pytest.raises(RobotFaultError, match=r"has stopped \(nan\): .* no finite number for joint joint1"):
            command(link)
        assert np.isfinite(link.state().positions).all()


def test_a_robot_that_measures_nan_from_the_beginning_is_not_driven() -> None:
    hardware = Follower()
    hardware.spoilt = replace(hardware.spoilt, positions=np.array([NAN, 0.0, 0.0]))
    with pytest.raises(ConfigurationError, match="no finite number for joint joint0"):
        RobotComputer(hardware)


def test_another_computer_that_sends_nan_is_one_error_and_is_stopped() -> None:
    with served() as (computer, _, _, link):

        def spoil(state: RobotState) -> None:
            numbers = {name: getattr(state, name) for name in state.__struct_fields__}
            for listener in listeners:
                listener(RobotState(**{**numbers, "positions": [NAN, 0.0, 0.0]}))

        listeners = list(computer.on_state)
        computer.on_state[:] = [spoil]
        with pytest.raises(RobotLinkError, match="sends no finite number for joint joint0"):
            command(link)
        computer.on_state[:] = listeners


@pytest.mark.parametrize("seconds", [5.0, -5.0])
def test_a_robot_whose_clock_jumps_is_one_error_and_rests(seconds: float) -> None:
    with served() as (_, _, clock, link):
        clock.jump(seconds)
        # A loop that catches up with a clock far ahead is silent meanwhile, and may be so for longer than links wait.
        causes = r"clock of the robot .* jumped|off the robot's clock" + ("|has not answered" if seconds > 2.0 else "")
        with pytest.raises((RobotLinkError, RobotFaultError), match=causes):
            command(link)


def test_late_messages_are_no_jump_of_the_clock_and_a_jump_is_measured() -> None:
    watch = StampWatch()
    for stamp, arrived in ((10.0, 5.0), (10.1, 6.9), (10.2, 6.91), (12.0, 7.0), (12.1, 7.1)):
        watch.add(stamp, arrived)
    assert watch.jump == 0.0
    watch.add(13.2, 7.2)
    assert watch.jump == pytest.approx(1.0)
    watch = StampWatch()
    watch.add(10.0, 5.0)
    watch.add(8.0, 5.1)
    assert watch.jump == pytest.approx(-2.0)
