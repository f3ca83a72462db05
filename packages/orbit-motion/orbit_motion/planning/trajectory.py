"""Timing of paths, within the joints' limits of velocity, acceleration and jerk."""

from __future__ import annotations

import itertools
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from orbit_core.installing import install_extra
from orbit_core.interfaces import ConfigurationError, PlanningError

_Array = npt.NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class JointTrajectory:
    """Positions and velocities (T, k) of k joints, every ``dt`` seconds from the start on."""

    dt: float
    positions: _Array
    velocities: _Array

    @property
    def duration(self) -> float:
        """Duration in s."""
        return self.dt * (len(self.positions) - 1)


def time_optimal(
    waypoints: npt.ArrayLike,
    velocity_limits: npt.ArrayLike,
    acceleration_limits: npt.ArrayLike,
    dt: float,
    spacing: float = 0.05,
) -> JointTrajectory:
    """Return the fastest motion along a path, from rest to rest, within limits of velocity and acceleration.

    Pham and Pham, A New Approach to Time-Optimal Path Parameterization Based on Reachability Analysis, IEEE
    Transactions on Robotics 34(3), 2018, by toppra. The path is a spline through points on the straight
    lines between the waypoints; it leaves those at corners by less than ``spacing``.

    Args:
        waypoints: (P, k) rad or m, P at least 2.
        velocity_limits: (k,) rad/s or m/s.
        acceleration_limits: (k,) rad/s^2 or m/s^2.
        dt: s from one sample to the next.
        spacing: rad or m between points of the spline, in the joint that travels most.

    Raises:
        ConfigurationError: toppra is not installed; or a limit is not above zero.
        PlanningError: the path has fewer than two points, or cannot be timed.
    """
    points, speeds, rates = _checked(waypoints, velocity_limits, acceleration_limits)
    toppra = _toppra()
    dense = _densified(points, spacing)
    steps = np.abs(np.diff(dense, axis=0)).max(1)
    path = toppra.SplineInterpolator(np.concatenate(([0.0], np.cumsum(steps))), dense)
    limits = [
        toppra.constraint.JointVelocityConstraint(np.stack((-speeds, speeds), 1)),
        toppra.constraint.JointAccelerationConstraint(np.stack((-rates, rates), 1)),
    ]
    solver = toppra.algorithm.TOPPRA(limits, path, parametrizer="ParametrizeConstAccel", solver_wrapper="seidel")
    timed = solver.compute_trajectory(0.0, 0.0)
    if timed is None:
        raise PlanningError("the path cannot be timed within its limits: give points that are further apart, or fewer")
    # Between grid points the timing exceeds the limits where the path bends: the whole is slowed down by the excess.
    fine = np.linspace(0.0, timed.duration, 2000)
    excess = max((np.abs(timed(fine, 1)) / speeds).max(), np.sqrt((np.abs(timed(fine, 2)) / rates).max()), 1.0)
    times = np.arange(0.0, excess * timed.duration + dt, dt).clip(max=excess * timed.duration) / excess
    return JointTrajectory(dt, timed(times), timed(times, 1) / excess)


def jerk_limited(
    waypoints: npt.ArrayLike,
    velocity_limits: npt.ArrayLike,
    acceleration_limits: npt.ArrayLike,
    jerk_limits: npt.ArrayLike,
    dt: float,
) -> JointTrajectory:
    """Return the straight lines between waypoints, each from rest to rest, within limits of velocity, acceleration and
    jerk.

    Berscheid and Kroeger, Jerk-limited Real-time Trajectory Generation with Arbitrary Target States, RSS 2021, by
    ruckig; all joints keep to one line.

    Args:
        waypoints: (P, k) rad or m, P at least 2.
        velocity_limits: (k,) rad/s or m/s.
        acceleration_limits: (k,) rad/s^2 or m/s^2.
        jerk_limits: (k,) rad/s^3 or m/s^3.
        dt: s from one sample to the next.

    Raises:
        ConfigurationError: ruckig is not installed; or a limit is not above zero.
        PlanningError: the path has fewer than two points, or cannot be timed.
    """
    points, speeds, rates, jerks = _checked(waypoints, velocity_limits, acceleration_limits, jerk_limits)
    positions, velocities = [points[:1]], [np.zeros_like(points[:1])]
    for start, end in itertools.pairwise(points):
        line = end - start
        # A repeated waypoint is no line.
        if not np.abs(line).max() > 0.0:
            continue
        # Timed along the line, so that the motion stays on it: the tightest joint decides.
        share = np.abs(line)
        limits = [float((limit[share > 0] / share[share > 0]).min()) for limit in (speeds, rates, jerks)]
        place, rate = _from_rest_to_rest(limits, dt)
        positions.append(start + place[1:, None] * line)
        velocities.append(rate[1:, None] * line)
    return JointTrajectory(dt, np.concatenate(positions), np.concatenate(velocities))


def _from_rest_to_rest(limits: list[float], dt: float) -> tuple[_Array, _Array]:
    """Compute position and rate (T,) of a motion from 0 to 1 within limits of velocity, acceleration and jerk."""
    ruckig = _ruckig()
    asked = ruckig.InputParameter(1)
    asked.current_position, asked.target_position = [0.0], [1.0]
    asked.max_velocity, asked.max_acceleration, asked.max_jerk = ([limit] for limit in limits)
    trajectory = ruckig.Trajectory(1)
    result = ruckig.Ruckig(1).calculate(asked, trajectory)
    if result not in (ruckig.Result.Working, ruckig.Result.Finished):
        raise PlanningError(f"the path cannot be timed within its limits: ruckig says {result}")
    times = np.arange(0.0, trajectory.duration + dt, dt).clip(max=trajectory.duration)
    samples = np.array([[part[0] for part in trajectory.at_time(time)[:2]] for time in times])
    return samples[:, 0], samples[:, 1]


def _checked(waypoints: npt.ArrayLike, *limits: npt.ArrayLike) -> list[_Array]:
    points = np.asarray(waypoints, dtype=np.float64)
    if points.ndim != 2 or len(points) < 2 or not np.isfinite(points).all():
        raise PlanningError(f"a path is two or more points of finite positions (P, k), not {points.shape}")
    arrays = [np.broadcast_to(np.asarray(limit, dtype=np.float64), points.shape[1:]) for limit in limits]
    if any(not (array > 0.0).all() for array in arrays):
        raise ConfigurationError("limits of velocity, acceleration and jerk must be above zero")
    return [points, *arrays]


def _densified(points: _Array, spacing: float) -> _Array:
    parts = [points[:1]]
    for start, end in itertools.pairwise(points):
        count = int(np.ceil(np.abs(end - start).max() / spacing))
        if count:
            parts.append(start + np.linspace(0.0, 1.0, count + 1)[1:, None] * (end - start))
    dense = np.concatenate(parts)
    if len(dense) < 2:
        raise PlanningError("all points of the path are the same: there is nothing to time")
    return dense


def _toppra() -> Any:
    try:
        import toppra
        import toppra.algorithm
        import toppra.constraint
    except ImportError:
        raise ConfigurationError(f"timing needs the package toppra: {install_extra('planning')}") from None
    return toppra


def _ruckig() -> Any:
    try:
        import ruckig
    except ImportError:
        raise ConfigurationError(f"timing needs the package ruckig: {install_extra('planning')}") from None
    return ruckig
