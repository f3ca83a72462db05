"""Commands that cannot be meant stop the robot, missing ones do too, and it always ends at rest within its limits."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import pytest
from msgspec import structs

from orbit_core.interfaces import ConfigurationError
from orbit_deploy.description import RobotDescription, check_robot
from orbit_deploy.follower import FollowerSettings, JointFollower, PathKind
from orbit_deploy.messages import JointCommand, Mode
from tests.deploy.rig import PERIOD, description

MS = 1_000_000
START = 10**9


class Driven:
    """A follower that is swung at two thirds of its speed limit."""

    def __init__(self) -> None:
        self.follower = JointFollower(description(), FollowerSettings())
        self.follower.begin(PERIOD)
        self.now, self.number = START, 0
        self.positions: list[np.ndarray] = []
        for _ in range(20):
            self.command()
            self.run(20)

    def command(self, **changes: object) -> object:
        targets = [1.3 * 1e-9 * (self.now - START)] * 3
        command = JointCommand(self.number, self.now, targets, [0.0] * 3, [0.0] * 3)
        self.number += 1
        return self.follower.submit(structs.replace(command, **changes), self.now)

    def run(self, cycles: int) -> None:
        for _ in range(cycles):
            self.now += MS
            self.positions.append(self.follower.sample(self.now).positions)


BAD = {
    "nan": lambda now: {"positions": [math.nan, 0.0, 0.0]},
    "shape": lambda now: {"positions": [0.0] * 4},
    "limit": lambda now: {"positions": [9.0, 0.0, 0.0]},
    "time": lambda now: {"stamp": now + 600 * MS},
    "jump": lambda now: {"positions": [-1.5, 0.0, -1.5]},
}


@pytest.mark.parametrize("code", BAD)
def test_a_command_that_cannot_be_meant_stops_the_robot_until_it_is_cleared(code: str) -> None:
    driven = Driven()
    if code == "jump":
        driven.follower = JointFollower(description(), FollowerSettings(jump=0.3))
        driven.follower.begin(PERIOD)
    fault = driven.command(**BAD[code](driven.now))
    assert getattr(fault, "code", "") == code
    assert driven.command() is None
    assert driven.follower.accepted < driven.number - 2 or code == "jump"  # what comes after is not heard
    driven.run(600)
    assert driven.follower.mode is Mode.FAULT
    assert driven.follower.limiter.at_rest
    driven.follower.clear()
    assert driven.follower.mode is Mode.HOLDING


def test_velocities_and_efforts_beyond_twice_their_limits_are_refused_and_less_is_clamped() -> None:
    for field, limit in (("velocities", 2.0), ("efforts", 50.0)):
        driven = Driven()
        assert driven.command(**{field: [1.5 * limit, 0.0, 0.0]}) is None
        assert driven.follower.clamped == 1
        assert getattr(driven.command(**{field: [0.0, 2.1 * limit, 0.0]}), "code", "") == "limit"


def test_cycles_in_which_limits_hold_the_joints_back_are_counted_in_each_session() -> None:
    follower = JointFollower(description(), FollowerSettings())
    for reach, least, most in ((0.01, 0, 0), (1.0, 50, 400)):
        follower.begin(PERIOD)
        assert follower.limited == 0
        for cycle in range(400):
            now = START + cycle * MS
            if cycle % 20 == 0:
                targets = [reach * np.sign(np.sin(0.1 * cycle))] * 3
                assert follower.submit(JointCommand(cycle, now, targets, [0.0] * 3, [0.0] * 3), now) is None
            follower.sample(now)
        assert least <= follower.limited <= most


def test_efforts_rise_within_a_tenth_of_a_second() -> None:
    driven = Driven()
    driven.command(efforts=[50.0, 0.0, 0.0])
    driven.now += MS
    assert driven.follower.sample(driven.now).efforts[0] == pytest.approx(0.5)


def test_missing_commands_stop_the_robot_in_time_and_within_limits_and_the_next_ones_continue() -> None:
    driven = Driven()
    lost = len(driven.positions)
    driven.run(600)
    path = np.array(driven.positions)
    speeds = np.abs(np.diff(path, axis=0)).max(1) * 1000.0
    assert speeds[lost] > 1.0
    assert np.flatnonzero(speeds[lost:] < 0.95 * speeds[lost])[0] < 100  # ms until it brakes
    assert speeds[-1] == 0.0
    assert (np.abs(np.diff(path, 3, axis=0)) * 1e9 <= driven.follower.limits.jerk * (1.0 + 1e-5)).all()
    assert (driven.follower.mode, driven.follower.stops) == (Mode.HOLDING, 1)
    rest = driven.positions[-1]
    assert driven.command(positions=(rest + 0.05).tolist()) is None
    driven.run(50)
    assert driven.follower.mode is Mode.FOLLOWING
    assert (driven.positions[-1] > rest).all()
    assert (np.abs(np.diff(driven.positions, 3, axis=0)) * 1e9 <= driven.follower.limits.jerk * (1.0 + 1e-5)).all()


def test_commands_that_are_repeated_or_overtaken_do_nothing() -> None:
    driven = Driven()
    accepted = driven.follower.accepted
    assert driven.command(sequence=accepted, positions=[math.nan] * 3) is None
    assert driven.follower.accepted == accepted


def test_a_slow_motion_keeps_a_fifth_of_the_speed_and_ends_there() -> None:
    follower = JointFollower(description(), FollowerSettings())
    assert follower.move_to([0.2, -0.2, 5.0], START) is None
    positions = []
    for cycle in range(6000):
        positions.append(follower.sample(START + cycle * MS).positions)
        if follower.mode is Mode.HOLDING:
            break
    assert np.abs(np.diff(positions, axis=0)).max() * 1000.0 == pytest.approx(0.4, rel=1e-3)
    assert positions[-1] == pytest.approx([0.2, -0.2, 1.5])


def test_direct_commands_need_the_robots_permission() -> None:
    with pytest.raises(ConfigurationError, match="takes no direct commands"):
        JointFollower(description(), FollowerSettings()).begin(PERIOD, PathKind.DIRECT)
    follower = JointFollower(structs.replace(description(), direct=True), FollowerSettings())
    follower.begin(PERIOD, PathKind.DIRECT)
    assert follower.submit(JointCommand(0, START, [0.3] * 3, [0.0] * 3, [0.0] * 3), START) is None
    assert follower.sample(START + MS).positions == pytest.approx(0.3)
    follower.measured = np.full(3, 0.1)
    follower.stop()
    assert follower.sample(START + 2 * MS).positions == pytest.approx(0.1)


def changed(**changes: object) -> Callable[[RobotDescription], RobotDescription]:
    return lambda told: structs.replace(told, **changes)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (changed(joints=["joint0", "joint2", "joint1"]), "others or in another order"),
        (changed(joints=["joint0", "joint1", "other"]), "lacks joint2"),
        (changed(kinds=["position", "position", "effort"]), "joint2 .* takes effort commands"),
    ],
)
def test_a_robot_with_other_joints_is_refused(
    change: Callable[[RobotDescription], RobotDescription], words: str
) -> None:
    with pytest.raises(ConfigurationError, match=words):
        check_robot(description(), change(description()), "here")


def test_other_gains_are_told_with_the_joint_and_both_numbers() -> None:
    served = structs.replace(description(), stiffness=[400.0, 300.0, 400.0])
    assert check_robot(description(), served, "here") == ["stiffness of joint1 is 300 at the robot and 400 in the task"]


@pytest.mark.parametrize("setting", [{"watchdog": 0.0}, {"jump": math.nan}, {"moving_speed": 2.0}])
def test_settings_that_cannot_be_are_refused(setting: dict[str, float]) -> None:
    with pytest.raises(ConfigurationError, match=next(iter(setting))):
        FollowerSettings(**setting)
