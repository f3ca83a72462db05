"""A path through commands keeps the limits at every sample, whatever the commands are."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import numpy.typing as npt
import pytest

from orbit_deploy.follower import FollowerSettings, JointFollower
from orbit_deploy.limiter import MotionLimiter, stopping_range
from orbit_deploy.messages import JointCommand
from orbit_deploy.playout import DriveResponse, QuinticPlayout
from tests.deploy.rig import PERIOD, description

Array = npt.NDArray[np.float64]
LIMITS = description().limits
MS = 1_000_000
_RNG = np.random.default_rng(0)


def smooth(t: float) -> Array:
    return 0.3 * np.sin(2.0 * np.pi * 0.5 * t) * np.ones(3)


def noisy(t: float) -> Array:
    return smooth(t) + _RNG.normal(0.0, 0.003, 3)


def erratic(t: float) -> Array:
    return _RNG.uniform(-0.8, 0.8, 3)


def into_the_stops(t: float) -> Array:
    return np.clip(4.0 * t, 0.0, 1.6) * np.array([1.0, -1.0, 1.0])


def samples(command: Callable[[float], Array], seconds: float) -> Array:
    """(T, 3) positions at 1000 Hz of a follower that gets a command in each period."""
    follower = JointFollower(description(), FollowerSettings())
    follower.begin(PERIOD)
    found = []
    for cycle in range(round(1000 * seconds)):
        now = 10**9 + cycle * MS
        if cycle % round(1000 * PERIOD) == 0:
            targets = command(1e-3 * cycle).tolist()
            assert follower.submit(JointCommand(cycle, now, targets, [0.0] * 3, [0.0] * 3), now) is None
        found.append(follower.sample(now).positions)
    return np.array(found)


@pytest.mark.parametrize("command", [smooth, noisy, erratic, into_the_stops])
def test_every_sample_keeps_position_velocity_acceleration_and_jerk(command: Callable[[float], Array]) -> None:
    positions = samples(command, 0.8)
    assert np.abs(np.diff(positions, axis=0)).max() > 1e-4  # it moves
    for order, limit in ((1, LIMITS.velocity), (2, LIMITS.acceleration), (3, LIMITS.jerk)):
        # Third differences of doubles at 1000 Hz are exact to some 1e-6 of a jerk.
        assert (np.abs(np.diff(positions, order, axis=0)) * 1000.0**order <= limit * (1.0 + 1e-5)).all()
    assert (positions >= LIMITS.lower - 1e-9).all()
    assert (positions <= LIMITS.upper + 1e-9).all()


def test_smooth_commands_are_followed_one_period_and_the_jitter_later() -> None:
    positions, lag = samples(smooth, 1.2), round(1000 * (PERIOD + FollowerSettings().jitter))
    wanted = np.array([smooth(1e-3 * (cycle - lag)) for cycle in range(len(positions))])
    assert np.abs(positions - wanted)[500:].max() < 2e-3


@pytest.mark.parametrize("share", [0.02, 0.3, 1.0])
def test_the_way_to_rest_is_known_in_closed_form(share: float) -> None:
    limiter, random = MotionLimiter(LIMITS, 1e-3), np.random.default_rng(1)
    for _ in range(10):
        limiter.velocity = share * random.uniform(-0.4, 0.4, 3)
        limiter.position, limiter.acceleration = np.zeros(3), random.uniform(-1.0, 1.0, 3) * LIMITS.acceleration
        low, high = stopping_range(limiter.velocity, limiter.acceleration, LIMITS)
        way = [limiter.position]
        while not limiter.at_rest:
            limiter.brake()
            way.append(limiter.position)
        # Samples of a path may miss its turning point by a little.
        assert np.allclose(np.min(way, 0), low, atol=1e-5)
        assert np.allclose(np.max(way, 0), high, atol=1e-5)


def test_a_joint_next_to_its_stop_leaves_it() -> None:
    # Ruckig tells extrema of a stop that hold zeros: a limiter that took them for true stayed where it was.
    limits = description().limits
    limits.upper[:] = -0.05
    limiter = MotionLimiter(limits, 1e-3)
    limiter.reset(np.full(3, -0.5))
    for _ in range(600):
        limiter.follow(np.full(3, -0.2), np.zeros(3), np.zeros(3))
    assert np.allclose(limiter.position, -0.2)


def test_a_step_makes_no_run_up_and_no_overshoot() -> None:
    def step(t: float) -> Array:
        return np.array([0.3, -0.3, 0.05]) * (t > 0.1)

    positions = samples(step, 0.8)
    along = positions * np.sign([0.3, -0.3, 0.05])
    assert along.min() > -1e-4
    assert (np.abs(positions) < np.array([0.3, 0.3, 0.05]) + 1e-3).all()
    assert np.allclose(positions[-1], [0.3, -0.3, 0.05], atol=1e-4)


def test_a_quintic_path_goes_through_its_knots_with_continuous_acceleration() -> None:
    path = QuinticPlayout(np.zeros(1), 0.024, PERIOD, np.full(1, 10.0))
    knots = [0.02 * np.sin(0.3 * i) * np.ones(1) for i in range(20)]
    found, times = [], np.arange(0.0, 0.3, 1e-3)
    for time in times:
        if round(1000 * time) % 20 == 0:
            path.add(time, knots[round(time / PERIOD)])
        found.append(np.stack(path.sample(time)))
    positions, _, accelerations = np.array(found)[..., 0].T
    for number in range(2, 12):
        at = round(1000 * (PERIOD * number + 0.024))
        assert positions[at] == pytest.approx(knots[number][0], abs=2e-5)
    # The first knots are a start from rest; a jump of acceleration later would be 4 rad/s^2.
    assert np.abs(np.diff(accelerations[120:])).max() < 2.0


def test_a_drives_response_nears_its_target_with_the_drives_time_constant() -> None:
    path = DriveResponse(np.zeros(2), 0.0, np.array([5.0, 50.0]))
    path.sample(1.0)
    path.add(1.0, np.ones(2))
    for time in np.arange(1.0, 1.2, 1e-3):
        position, velocity, _ = path.sample(time)
    assert position == pytest.approx(1.0 - np.exp(-np.array([5.0, 50.0]) * 0.199), abs=1e-9)
    assert velocity == pytest.approx(np.array([5.0, 50.0]) * (1.0 - position))
