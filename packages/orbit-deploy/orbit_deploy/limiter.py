"""Limits of position, velocity, acceleration and jerk, held at every sample of a path."""

from __future__ import annotations

import numpy as np
import ruckig
from ruckig import ControlInterface, InputParameter, OutputParameter, Ruckig, Synchronization

from orbit_deploy.description import FloatArray, MotionLimits

# Ruckig rejects targets at a limit that rounding puts beyond it
_MARGIN = 0.98
# rad or m of a position limit that rounding may exceed
_ROUNDING = 1e-9


class MotionLimiter:
    """Follows any path as fast as the limits allow, joint by joint; from each of its samples the robot can stop.

    One sample takes some 20 microseconds for 9 joints.

    Args:
        limits: of the joints.
        period: seconds between samples.
        velocity_driven: (J,) bool, the joints that follow a velocity and have no position to reach.
    """

    def __init__(self, limits: MotionLimits, period: float, velocity_driven: FloatArray | None = None) -> None:
        joints = len(limits.lower)
        self._limits = limits
        self._driven = np.zeros(joints, bool) if velocity_driven is None else velocity_driven.astype(bool)
        self._speed, self._most = limits.velocity * _MARGIN, limits.acceleration * _MARGIN
        # A position limit of a wheel would be one of its angle.
        self._lower = np.where(self._driven, -np.inf, limits.lower)
        self._upper = np.where(self._driven, np.inf, limits.upper)
        # A tenth of the speed gained in a sample, so that a path may start from rest
        self._slack = 0.1 * limits.acceleration * period
        self._bounded = bool(np.isfinite(self._lower).any() or np.isfinite(self._upper).any())
        self._following, self._braking = Ruckig(joints, period), Ruckig(joints, period)
        self._input, self._brake = self._inputs(limits), self._inputs(limits)
        self._input.per_dof_control_interface = [
            ControlInterface.Velocity if driven else ControlInterface.Position for driven in self._driven
        ]
        self._brake.control_interface = ControlInterface.Velocity
        self._brake.target_velocity = self._brake.target_acceleration = [0.0] * joints
        self._output, self._brake_output = OutputParameter(joints), OutputParameter(joints)
        self.reset(np.zeros(joints))

    def reset(self, positions: FloatArray) -> None:
        """Rest at positions (J,)."""
        self.position = np.clip(positions, self._lower, self._upper)
        """(J,) of the last sample, rad or m."""
        self.velocity = np.zeros_like(self.position)
        """(J,) of the last sample, rad/s or m/s."""
        self.acceleration = np.zeros_like(self.position)
        """(J,) of the last sample, rad/s^2 or m/s^2."""

    @property
    def at_rest(self) -> bool:
        """True if the last sample neither moves nor accelerates."""
        return bool(np.abs(self.velocity).max(initial=0.0) < 1e-6 and np.abs(self.acceleration).max(initial=0.0) < 1e-4)

    def follow(self, position: FloatArray, velocity: FloatArray, acceleration: FloatArray, speed: float = 1.0) -> None:
        """Compute the next sample towards a state of the path.

        Args:
            position: (J,) rad or m.
            velocity: (J,) rad/s or m/s; the target of joints that are driven by velocity.
            acceleration: (J,) rad/s^2 or m/s^2.
            speed: share of the velocity limit that may be used, in (0, 1].
        """
        top = self._speed * speed
        goal = np.clip(position, self._lower, self._upper)
        rate = np.clip(velocity, -top, top)
        # A path that leaves the range ends at it.
        rate = np.where(goal == position, rate, 0.0)
        # A faster target would need a run-up: Ruckig would first go the other way, and so a step become a swing.
        side = np.sign(rate)
        along, ahead = np.maximum(side * self.velocity, 0.0), np.maximum(side * (goal - self.position), 0.0)
        by_jerk = along + np.cbrt(self._limits.jerk * ahead**2)
        reached = np.minimum(np.sqrt(along**2 + self._most * ahead), by_jerk) + self._slack
        on_path = (goal == position) & (np.abs(rate) <= reached) & (np.abs(rate - self.velocity) <= 10.0 * self._slack)
        rate = side * np.minimum(np.abs(rate), reached)
        # Beyond this acceleration the velocity would pass its limit before the jerk has ended it.
        most = np.minimum(self._most, np.sqrt(2.0 * self._limits.jerk * np.maximum(top - np.abs(rate), 0.0)))
        bend = np.where(on_path, np.clip(acceleration, -most, most), 0.0)
        given = self._input
        given.max_velocity = (self._limits.velocity * speed).tolist()
        given.target_position, given.target_velocity = goal.tolist(), rate.tolist()
        given.target_acceleration = bend.tolist()
        self._start(given)
        try:
            result = self._following.update(given, self._output)
        except ruckig.RuckigError:
            result = ruckig.Result.Error
        if result not in (ruckig.Result.Working, ruckig.Result.Finished):
            self.brake()
            return
        new = [np.array(values) for values in _state(self._output)]
        if self._bounded:
            self._keep_room(new)
        self.position, self.velocity, self.acceleration = new

    def brake(self) -> None:
        """Compute the next sample of the fastest stop within limits."""
        self._start(self._brake)
        self._braking.update(self._brake, self._brake_output)
        self.position, self.velocity, self.acceleration = (np.array(values) for values in _state(self._brake_output))

    def _keep_room(self, new: list[FloatArray]) -> None:
        """Brake the joints that could not stop before their position limit after the new sample."""
        position, velocity, acceleration = new
        # An upper bound of the way to rest spares most samples the exact one.
        speed = np.abs(velocity) + acceleration**2 / (2.0 * self._limits.jerk)
        way = speed**2 / (2.0 * self._limits.acceleration) + speed * self._limits.acceleration / self._limits.jerk
        way += speed * np.abs(acceleration) / self._limits.jerk
        if np.all((position - way >= self._lower) & (position + way <= self._upper)):
            return
        low, high = stopping_range(velocity, acceleration, self._limits)
        short = (position + low < self._lower - _ROUNDING) | (position + high > self._upper + _ROUNDING)
        if short.any():
            # By induction the sample before leaves room for the stop that begins there.
            self._start(self._brake)
            self._braking.update(self._brake, self._brake_output)
            for values, stopped in zip(new, _state(self._brake_output), strict=True):
                values[short] = np.array(stopped)[short]

    def _start(self, given: InputParameter) -> None:
        given.current_position, given.current_velocity = self.position.tolist(), self.velocity.tolist()
        given.current_acceleration = self.acceleration.tolist()

    @staticmethod
    def _inputs(limits: MotionLimits) -> InputParameter:
        given = InputParameter(len(limits.lower))
        given.max_velocity, given.max_acceleration = limits.velocity.tolist(), limits.acceleration.tolist()
        given.max_jerk = limits.jerk.tolist()
        given.synchronization = Synchronization.No
        return given


def stopping_range(
    velocity: FloatArray, acceleration: FloatArray, limits: MotionLimits
) -> tuple[FloatArray, FloatArray]:
    """Return the least and the greatest displacement (J,) on the way of the fastest stop, in closed form.

    Ruckig's own extrema of a stop hold zeros for some profiles (0.19.4).

    Args:
        velocity: (J,) rad/s or m/s.
        acceleration: (J,) rad/s^2 or m/s^2, within its limit.
        limits: of the joints.
    """
    jerk, most = limits.jerk, limits.acceleration
    # Mirrored so that the stop ends with a negative acceleration.
    side = np.where(velocity + acceleration * np.abs(acceleration) / (2.0 * jerk) >= 0.0, 1.0, -1.0)
    v, a = side * velocity, side * acceleration
    square = np.maximum(jerk * v + 0.5 * a**2, 0.0)
    peak = np.minimum(np.sqrt(square), most)
    first, held, last = (a + peak) / jerk, np.maximum(square - peak**2, 0.0) / (jerk * most), peak / jerk
    end = v * first + 0.5 * a * first**2 - jerk * first**3 / 6.0
    speed = v + a * first - 0.5 * jerk * first**2
    end += speed * held - 0.5 * peak * held**2
    speed = speed - peak * held
    end += speed * last - 0.5 * peak * last**2 + jerk * last**3 / 6.0
    # A joint that still moves away from where it will stop turns on the way.
    turn = (a - np.sqrt(np.maximum(a**2 + 2.0 * jerk * np.minimum(v, 0.0), 0.0))) / jerk
    turning = np.where((v < 0.0) & (a > 0.0), v * turn + 0.5 * a * turn**2 - jerk * turn**3 / 6.0, 0.0)
    ends = side * np.stack((np.zeros_like(end), end, turning))
    return ends.min(0), ends.max(0)


def _state(output: OutputParameter) -> tuple[list[float], list[float], list[float]]:
    return output.new_position, output.new_velocity, output.new_acceleration
