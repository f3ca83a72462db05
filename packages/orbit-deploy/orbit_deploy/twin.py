"""Digital twins: simulated robots that follow a robot's commands, live or from a log, and how far they are off."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import torch

from orbit_core.interfaces import ConfigurationError, JointTarget
from orbit_core.scene import RobotSpec, Scene
from orbit_core.world import simulate
from orbit_deploy.description import FloatArray
from orbit_deploy.log_replay import predict, rms
from orbit_deploy.messages import RobotState
from orbit_deploy.motion_log import MotionLog


@dataclass(frozen=True)
class TwinResult:
    """Difference between a log and the simulation that followed its targets on one engine."""

    backend: str
    """Name of the engine."""
    positions: FloatArray
    """(T, J) simulated positions at the log's rows, rad or m."""
    rms: float
    """Root mean square of simulated minus recorded positions, rad or m."""
    by_joint: dict[str, float]
    """The same for each joint."""
    largest: float
    """Largest difference, rad or m."""


def replay_twin(
    log: MotionLog, spec: RobotSpec, backend: str, delay: float = 0.0, dt: float | None = None
) -> TwinResult:
    """Have a simulated robot follow a log's targets from the log's first state on.

    Args:
        log: recorded motion.
        spec: robot, with a fixed base.
        backend: name of the physics backend.
        delay: seconds between a target and its effect, as of a fitted robot.
        dt: seconds of a physics step; the robot's own cycle if None.

    Raises:
        ConfigurationError: the log is of another robot, or the robot's base moves.
    """
    log = log.ordered(tuple(joint.name for joint in spec.articulation.movable_joints))
    positions = predict(log, spec, backend, delay, dt)
    away = positions - log.position
    by_joint = {name: rms(away[:, column]) for column, name in enumerate(log.joints)}
    return TwinResult(backend, positions, rms(away), by_joint, float(np.abs(away).max()))


class LiveTwin:
    """Simulated robot that follows the targets in a robot's states, as they come.

    Args:
        spec: robot; its base is fixed where it is.
        backend: name of the physics backend.
        dt: seconds of a physics step.
        settings: of the backend, by field name.
    """

    def __init__(
        self, spec: RobotSpec, backend: str, dt: float = 0.002, settings: dict[str, object] | None = None
    ) -> None:
        if not spec.fixed_base:
            raise ConfigurationError(
                f"the base of '{spec.articulation.name}' moves: a twin follows robots with a fixed base"
            )
        self._dt = dt
        # Without the task's objects: a twin shows what the drives do, not what the robot touches.
        self._world = simulate(Scene(robots=(spec,), physics_dt=dt), 1, backend, settings=settings)
        self._robot = next(iter(self._world.robots.values()))
        joints = range(len(spec.articulation.movable_joints))
        # A robot's follower has made them finite: looking again would cost time in every step.
        self._writers = [self._robot.target_writer(each, joints, checked=False) for each in JointTarget]
        self._stamp: int | None = None
        self._before = np.zeros((3, len(joints)))

    @property
    def positions(self) -> FloatArray:
        """Simulated positions (J,), rad or m."""
        return self._robot.joint_positions[0].double().numpy()

    def restart(self, state: RobotState) -> None:
        """Put the twin where the robot is, as at the beginning of an episode."""
        self._world.reset()
        self._robot.set_joint_state(_row(state.positions), _row(state.velocities))
        self._stamp, self._before = state.stamp, _targets(state)

    def follow(self, state: RobotState) -> FloatArray:
        """Simulate until the time of a state, with targets on a line from the state before to this one.

        A robot that was put elsewhere, or not heard of for half a second, takes its twin along.

        Returns:
            Simulated minus measured positions (J,), rad or m.
        """
        if self._stamp is None or not 0 <= state.stamp - self._stamp < 5e8:
            self.restart(state)
        assert self._stamp is not None, "a restart sets it"
        # States are tens of milliseconds apart, and the drives' targets move in between.
        targets, steps = _targets(state), round(1e-9 * (state.stamp - self._stamp) / self._dt)
        for step in range(steps):
            given = self._before + (targets - self._before) * (step + 1) / steps
            for writer, values in zip(self._writers, given, strict=True):
                writer(_row(values))
            self._world.step(1)
        if steps:
            # What is left of a step counts for the next state.
            self._stamp += round(1e9 * steps * self._dt)
            self._before = targets
        return self.positions - np.array(state.positions)

    def close(self) -> None:
        """Close the simulation; idempotent."""
        self._world.close()


def play(
    log: MotionLog,
    result: TwinResult,
    show: Callable[[float, int], None],
    wait: Callable[[float], None],
    speed: float = 1.0,
    rate: float = 30.0,
) -> None:
    """Show a replayed log at a speed.

    Args:
        log: recorded motion.
        result: of :func:`replay_twin`.
        show: called with a time of the log and its row.
        wait: waits a number of seconds.
        speed: seconds of the log per second.
        rate: calls per second.
    """
    for when in np.arange(0.0, log.duration, speed / rate):
        show(float(when), int(np.searchsorted(log.times, when)))
        wait(1.0 / rate)


def summary(results: Sequence[TwinResult]) -> dict[str, dict[str, float]]:
    """Return the differences of each engine as plain data."""
    return {each.backend: {"rms": each.rms, "largest": each.largest, **each.by_joint} for each in results}


def _targets(state: RobotState) -> FloatArray:
    return np.array((state.targets, state.target_velocities, state.target_efforts), np.float64)


def _row(values: Sequence[float] | FloatArray) -> torch.Tensor:
    return torch.from_numpy(np.asarray(values, np.float32))[None]
