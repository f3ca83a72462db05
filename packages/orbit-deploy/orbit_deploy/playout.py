"""Paths from commands at a client's rate, to be sampled at the robot's.

:class:`QuinticPlayout` goes through the commands, with a delay; :class:`DriveResponse` moves as the drives that a
policy was trained with would have moved the joints.
"""

from __future__ import annotations

from collections import deque
from typing import Protocol

import numpy as np

from orbit_deploy.description import FloatArray


class CommandPath(Protocol):
    """Path that a client's commands give, before any limits."""

    delay: float
    """Seconds between a command's stamp and its effect."""

    def restart(self, positions: FloatArray) -> None:
        """Forget all commands; the path rests at ``positions`` (J,)."""
        ...

    def add(self, time: float, positions: FloatArray) -> None:
        """Append a command.

        Args:
            time: its stamp, s; later than that of the one before.
            positions: (J,) rad or m.
        """
        ...

    def sample(self, time: float) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return position, velocity and acceleration (J,) of the path at a time, which does not decrease."""
        ...


class DriveResponse(CommandPath):
    """Path of joints that soft drives pull towards the commands, which hold until the next one.

    A drive of stiffness k and damping d that carries little inertia follows its target with the time constant d / k.
    A policy that was trained with such drives sends targets far ahead of the joints: to go through them would be
    another motion. This one is what the policy expects, and smooth.

    Args:
        positions: (J,) where the path begins, at rest.
        delay: seconds between a command's stamp and its effect.
        rates: (J,) of the drives, stiffness over damping, 1/s.
    """

    def __init__(self, positions: FloatArray, delay: float, rates: FloatArray) -> None:
        self.delay, self._rates = delay, rates
        self._commands: deque[tuple[float, FloatArray]] = deque()
        self.restart(positions)

    def restart(self, positions: FloatArray) -> None:
        self._commands.clear()
        self._position, self._target, self._time = positions.copy(), positions.copy(), -np.inf

    def add(self, time: float, positions: FloatArray) -> None:
        self._commands.append((time + self.delay, positions))

    def sample(self, time: float) -> tuple[FloatArray, FloatArray, FloatArray]:
        while self._commands and self._commands[0][0] <= time:
            self._target = self._commands.popleft()[1]
        # The first sample sets the time only: nothing has pulled before.
        passed = time - self._time if np.isfinite(self._time) else 0.0
        self._time = time
        # The exact solution of a drive without inertia, stable at any rate and period.
        away = self._target - self._position
        self._position = self._position + away * -np.expm1(-self._rates * passed)
        velocity = self._rates * (self._target - self._position)
        return self._position, velocity, np.zeros_like(velocity)


class QuinticPlayout(CommandPath):
    """Path through knots that arrive at some tens of Hz, to be sampled at the robot's rate.

    A knot is reached ``delay`` after its time stamp, so that jitter of the arrival up to the delay, less one period of
    the commands, drops out. A segment begins with the position, velocity and acceleration that the one before ended
    with, so that the path's acceleration is continuous.

    The path may exceed limits: a :class:`~orbit_deploy.limiter.MotionLimiter` follows it.

    Args:
        positions: (J,) where the path begins, at rest.
        delay: seconds between a knot's stamp and its time on the path.
        hold: seconds for which the last velocity is continued when no knot follows.
        acceleration: (J,) limit, rad/s^2 or m/s^2, which separates curves from steps.
    """

    def __init__(self, positions: FloatArray, delay: float, hold: float, acceleration: FloatArray) -> None:
        self.delay, self.hold, self._acceleration = delay, hold, acceleration
        self._knots: deque[tuple[float, FloatArray]] = deque()
        self.restart(positions)

    def restart(self, positions: FloatArray) -> None:
        """Forget all knots; the path rests at ``positions`` (J,)."""
        self._knots.clear()
        zero = np.zeros_like(positions)
        self._start = 0.0
        self._end: float | None = None
        self._from = (positions.copy(), zero, zero)
        self._to = self._from
        self._slope = zero
        self._coefficients: FloatArray | None = None

    def add(self, time: float, positions: FloatArray) -> None:
        """Append a knot.

        Args:
            time: stamp of the command, s; later than that of the knot before.
            positions: (J,) rad or m.
        """
        self._knots.append((time + self.delay, positions))

    def sample(self, time: float) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return position, velocity and acceleration (J,) of the path at a time, which does not decrease."""
        while self._knots and (self._end is None or time >= self._end):
            self._begin_segment(time)
        if self._end is None:
            return self._from
        if self._coefficients is not None and time < self._end:
            return _evaluate(self._coefficients, time - self._start)
        # No knot has arrived in time: go on a little, then hold.
        position, velocity, _ = self._to
        zero = np.zeros_like(position)
        late = time - self._end
        if late < self.hold:
            return position + velocity * late, velocity, zero
        return position + velocity * self.hold, zero, zero

    def _begin_segment(self, time: float) -> None:
        end, target = self._knots.popleft()
        start = self._end
        if start is None or time - start > self.hold:
            # The first segment, or one after a pause, begins where the path is now.
            now = self.sample_resting(time)
            start, self._from, self._slope = time, now, np.zeros_like(target)
        else:
            self._from = self._to
        duration = end - start
        if duration <= 1e-4:
            # A knot that arrived after its time: the limiter turns the step into a motion.
            self._end, self._to = max(start, end), (target, np.zeros_like(target), np.zeros_like(target))
            self._start, self._coefficients = start, None
            return
        slope = (target - self._from[0]) / duration
        change = slope - self._slope
        # A change of slope that the joint could follow is taken for a curve, any other for a step.
        curve = np.abs(change) <= self._acceleration * duration
        if self._knots:
            following = (self._knots[0][1] - target) / max(self._knots[0][0] - end, 1e-4)
            velocity = np.where(curve, 0.5 * (slope + following), _agreeing(slope, following))
        else:
            velocity = np.where(curve, slope + 0.5 * change, _agreeing(slope, self._slope))
        acceleration = np.where(curve, change / duration, 0.0)
        self._to = (target, velocity, acceleration)
        self._start, self._end, self._slope = start, end, slope
        self._coefficients = _quintic(self._from, self._to, duration)

    def sample_resting(self, time: float) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return the place where the path rests after its last knot, at rest."""
        if self._end is None:
            return self._from
        position, velocity, _ = self._to
        zero = np.zeros_like(position)
        return position + velocity * min(max(time - self._end, 0.0), self.hold), zero, zero


def _agreeing(one: FloatArray, other: FloatArray) -> FloatArray:
    """Return the harmonic mean of two slopes, zero where their signs differ, so that the path does not overshoot."""
    product = one * other
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.where(product > 0.0, 2.0 * product / (one + other), 0.0)


def _quintic(
    start: tuple[FloatArray, FloatArray, FloatArray], end: tuple[FloatArray, FloatArray, FloatArray], duration: float
) -> FloatArray:
    """Return coefficients (6, J) of the polynomial from one state to another."""
    (p0, v0, a0), (p1, v1, a1), t = start, end, duration
    way = p1 - p0
    third = (20.0 * way - (8.0 * v1 + 12.0 * v0) * t - (3.0 * a0 - a1) * t**2) / (2.0 * t**3)
    fourth = (-30.0 * way + (14.0 * v1 + 16.0 * v0) * t + (3.0 * a0 - 2.0 * a1) * t**2) / (2.0 * t**4)
    fifth = (12.0 * way - 6.0 * (v1 + v0) * t - (a0 - a1) * t**2) / (2.0 * t**5)
    return np.stack((p0, v0, 0.5 * a0, third, fourth, fifth))


_DERIVATIVES = np.array([[1, 1, 1, 1, 1, 1], [0, 1, 2, 3, 4, 5], [0, 0, 2, 6, 12, 20]], np.float64)


def _evaluate(coefficients: FloatArray, t: float) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return value and two derivatives (J,) at ``t`` seconds."""
    powers = np.array(
        [[1.0, t, t**2, t**3, t**4, t**5], [0.0, 1.0, t, t**2, t**3, t**4], [0.0, 0.0, 1.0, t, t**2, t**3]]
    )
    position, velocity, acceleration = (powers * _DERIVATIVES) @ coefficients
    return position, velocity, acceleration
