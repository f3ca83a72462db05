"""Nodes that follow plans: trajectories of joints, and paths of a base."""

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor

from orbit_core.actions.base import JointTarget
from orbit_core.actions.mobile_base import PURSUIT_RATE, BaseVelocityConfig, command_towards
from orbit_core.dynamics.transforms import yaw_angle
from orbit_core.installing import install_extra
from orbit_core.interfaces import ConfigurationError, Node, PlanningError, Port, Robot

# Timing of paths, within the joints' limits of velocity, acceleration and jerk ----------------------------------------

_Array = npt.NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class JointTrajectory:
    """Positions and velocities (T, k) of k joints, every ``dt`` seconds from the start on."""

    dt: float
    positions: _Array
    """(T, k) rad or m."""
    velocities: _Array
    """(T, k) rad/s or m/s."""

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


class TrajectoryFollower(Node):
    """Node that gives targets of joints along each environment's own trajectory, and holds its end.

    An environment without a trajectory holds the positions measured when it was reset. Each computation advances the
    time by the node's period.

    Args:
        name: of the node.
        robot: whose joints move.
        joints: their indices.
        rate: Hz; must divide the agent's.
    """

    def __init__(self, name: str, robot: Robot, joints: Sequence[int], rate: float) -> None:
        if not rate > 0.0:
            raise ConfigurationError(f"node '{name}': its rate is {rate:g} Hz, give one above zero")
        self.name, self.rate = name, rate
        self._robot, self._joints = robot, list(joints)
        count = len(self._joints)
        self.outputs = (Port(JointTarget.POSITION, (count,)), Port(JointTarget.VELOCITY, (count,)))
        self._envs = torch.arange(robot.joint_positions.shape[0], device=robot.joint_positions.device)
        self._positions = robot.joint_positions[:, None, self._joints].clone()
        self._velocities = torch.zeros_like(self._positions)
        self._last, self._step = torch.zeros(2, len(self._envs), device=self._positions.device).unbind()
        self._elapsed = torch.zeros_like(self._step)

    def load(self, trajectories: Mapping[int, JointTrajectory]) -> None:
        """Begin trajectories in some environments, by index, at the next computation.

        Raises:
            ConfigurationError: a trajectory is of another number of joints.
        """
        for env, trajectory in trajectories.items():
            if trajectory.positions.shape[1] != len(self._joints):
                raise ConfigurationError(
                    f"node '{self.name}' moves {len(self._joints)} joints, but the trajectory of environment {env} is "
                    f"of {trajectory.positions.shape[1]}"
                )
        # All environments share one tensor: shorter trajectories are padded.
        longest = max([self._positions.shape[1], *(len(t.positions) for t in trajectories.values())])
        self._positions, self._velocities = (longer(part, longest) for part in (self._positions, self._velocities))
        for env, trajectory in trajectories.items():
            length = len(trajectory.positions)
            for own, given in ((self._positions, trajectory.positions), (self._velocities, trajectory.velocities)):
                own[env, :length] = torch.as_tensor(given, dtype=own.dtype, device=own.device)
            self._last[env], self._step[env], self._elapsed[env] = length - 1, 1.0 / trajectory.dt, 0.0

    @property
    def finished(self) -> Tensor:
        """Return whether (N,) the trajectory's end is reached, or there is none."""
        return self._elapsed * self._step >= self._last

    def compute(self, inputs: Mapping[str, Tensor]) -> Mapping[str, Tensor]:
        assert self.rate is not None  # the constructor's
        place = torch.minimum(self._elapsed * self._step, self._last)
        before = place.floor().long()
        after = torch.minimum(before + 1, self._last.long())
        share = (place - before).unsqueeze(1)
        positions, velocities = (
            torch.lerp(part[self._envs, before], part[self._envs, after], share)
            for part in (self._positions, self._velocities)
        )
        # At the end the interpolated velocity need not be zero.
        velocities = velocities.masked_fill(self.finished.unsqueeze(1), 0.0)
        self._elapsed.add_(1.0 / self.rate)
        return {JointTarget.POSITION: positions, JointTarget.VELOCITY: velocities}

    def reset(self, env_ids: Tensor | None = None) -> None:
        rows = slice(None) if env_ids is None else env_ids
        self._last[rows] = 0.0
        self._elapsed[rows] = 0.0
        self._positions[rows, 0] = self._robot.joint_positions[:, self._joints][rows]
        self._velocities[rows, 0] = 0.0

    def memory(self) -> Mapping[str, Tensor]:
        return {"elapsed": self._elapsed, "last": self._last, "step": self._step}


def longer(part: Tensor, length: int) -> Tensor:
    """Pad a part (N, L, D) with zeros to (N, length, D)."""
    grown = part.new_zeros(part.shape[0], length, part.shape[2])
    grown[:, : part.shape[1]] = part
    return grown


# Metres from the end of the path within which a base turns to its final heading.
_ARRIVING = 0.5
# Cosine of the angle to the next place beyond which a base turns before it drives.
_AHEAD = 0.9
# Metres within which a base on two wheels drives backwards to a place behind it.
_CLOSE = 0.3
# Multiple of the tolerance at which a base on two wheels that has arrived drives back.
_STRAYED = 3.0


class BasePathFollower(Node):
    """Node whose commands of :class:`~orbit_core.actions.BaseVelocityConfig` lead each base along its own path.

    The base goes from place to place, and turns to the final heading; an environment without a path stands still. A
    base on two wheels (whose limit to the left is zero) turns to each place, drives there, and turns to its heading at
    the end.

    Args:
        name: of the node.
        robot: that drives or walks.
        config: of the generator that takes the commands; or that generator's
            :attr:`~orbit_core.actions.MotionGenerator.base_limits`, where another than a planar base moves.
        tolerance: metres from a place at which the base heads for the next.
        face_way: True if the base first turns towards its way, and to the final heading within half a metre of the end;
            else it turns on the way.

    Raises:
        ConfigurationError: the robot has no planar base.
    """

    def __init__(
        self,
        name: str,
        robot: Robot,
        config: BaseVelocityConfig | Tensor,
        tolerance: float = 0.05,
        face_way: bool = False,
    ) -> None:
        if isinstance(config, BaseVelocityConfig):
            config.default_joints(robot.spec)  # raises where there is no such base
            config = torch.tensor(config.limits)
        self.name = name
        self.outputs = (Port("command", (3,)),)
        self._robot, self._tolerance, self._face_way = robot, tolerance, face_way
        self._link = robot.link_names.index(robot.spec.base_link)
        pose = self._pose()
        self._limits = config.to(pose.device)
        self._sideways = bool(config[1] > 0.0)
        self._rows = torch.arange(len(pose), device=pose.device)
        self._places = pose[:, None, :2].clone()
        self._heading = pose[:, 2].clone()
        self._last, self._next = torch.zeros(2, len(pose), dtype=torch.int64, device=pose.device).unbind()
        self._drives, self._arrived = torch.zeros(2, len(pose), dtype=torch.bool, device=pose.device).unbind()

    def load(self, paths: Mapping[int, Tensor], headings: Mapping[int, float]) -> None:
        """Begin paths (P, 2), in the environments' frames, in some environments, each to end at its heading (rad).

        Raises:
            ConfigurationError: a path is not of finite places (P, 2), or has no heading.
        """
        for env, path in paths.items():
            if path.ndim != 2 or path.shape[1] != 2 or not len(path) or not bool(path.isfinite().all()):
                raise ConfigurationError(f"node '{self.name}': the path of environment {env} is not of finite (P, 2)")
            if env not in headings:
                raise ConfigurationError(f"node '{self.name}': the path of environment {env} has no heading at its end")
        longest = max([self._places.shape[1], *(len(path) for path in paths.values())])
        self._places = longer(self._places, longest)
        for env, path in paths.items():
            self._places[env, : len(path)] = path
            self._heading[env], self._last[env], self._next[env] = headings[env], len(path) - 1, 0
            self._drives[env], self._arrived[env] = True, False

    @property
    def finished(self) -> Tensor:
        """Return whether (N,) the base is at its path's end, or has no path."""
        away = torch.linalg.vector_norm(self._places[self._rows, self._last] - self._pose()[:, :2], dim=1)
        return ~self._drives | ((self._next == self._last) & (away < self._tolerance))

    def compute(self, inputs: Mapping[str, Tensor]) -> Mapping[str, Tensor]:
        pose = self._pose()
        # The place is advanced before the command, so that no step aims at a place that is reached.
        way = self._places[self._rows, self._next] - pose[:, :2]
        near = torch.linalg.vector_norm(way, dim=1) < self._tolerance
        self._next.copy_(torch.minimum(self._next + near, self._last))
        way = self._places[self._rows, self._next] - pose[:, :2]
        left = self._heading - pose[:, 2]
        if not self._sideways:
            return {"command": self._on_wheels(way, pose[:, 2], left) * self._drives[:, None]}
        if self._face_way:
            far = (self._next < self._last) | (torch.linalg.vector_norm(way, dim=1) > _ARRIVING)
            left = torch.where(far, torch.atan2(way[:, 1], way[:, 0]) - pose[:, 2], left)
            way = way * (~far | (left.cos() > _AHEAD))[:, None]
        displacement = torch.cat((way, torch.atan2(left.sin(), left.cos())[:, None]), 1)
        return {"command": command_towards(displacement, pose[:, 2], self._limits) * self._drives[:, None]}

    def _on_wheels(self, way: Tensor, heading: Tensor, left: Tensor) -> Tensor:
        """Compute the command (N, 3) of a base that cannot move sideways.

        Args:
            way: (N, 2) to the next place.
            heading: (N,) of the base.
            left: (N,) rotation to the final heading.
        """
        away = torch.linalg.vector_norm(way, dim=1)
        there = (self._next == self._last) & (away < self._tolerance)
        self._arrived.copy_(there | (self._arrived & (away < _STRAYED * self._tolerance)))
        bearing = torch.atan2(way[:, 1], way[:, 0]) - heading
        # Close behind, turning around would take longer than reversing.
        backs = (away < _CLOSE) & (bearing.cos() < 0.0)
        bearing = torch.where(self._arrived, left, bearing + math.pi * backs)
        ahead = torch.where(self._arrived | (bearing.cos() < _AHEAD), 0.0, away * (1.0 - 2.0 * backs.float()))
        turn = torch.atan2(bearing.sin(), bearing.cos())
        command = torch.stack((ahead / self._limits[0], torch.zeros_like(ahead), turn / self._limits[2]), 1)
        return (PURSUIT_RATE * command).clamp(-1.0, 1.0)

    def reset(self, env_ids: Tensor | None = None) -> None:
        self._drives[slice(None) if env_ids is None else env_ids] = False

    def memory(self) -> Mapping[str, Tensor]:
        own = {"next": self._next, "last": self._last, "drives": self._drives, "heading": self._heading}
        return own | {"arrived": self._arrived}

    def _pose(self) -> Tensor:
        """Return x, y and heading (N, 3) of the base."""
        pose = self._robot.link_poses[:, self._link]
        return torch.cat((pose[:, :2], yaw_angle(pose[:, 3:])[:, None]), 1)
