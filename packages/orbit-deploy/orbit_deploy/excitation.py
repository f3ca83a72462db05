"""Motion of a robot from whose log its parameters can be identified: a sum of sines within the limits of the joints."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from orbit_core.interfaces import ConfigurationError
from orbit_deploy.description import FloatArray, JointKind, RobotDescription
from orbit_deploy.link import RobotLink
from orbit_deploy.log import RobotLog
from orbit_deploy.messages import Mode

PERIOD = 0.02
"""Seconds between the commands of a motion."""
# s between the states that are logged: those of ORBIT's computers come at 500 Hz
_LOOK = 0.002
# Share of a joint's range, and of its limits of velocity, acceleration and jerk, that a motion uses
_ROOM, _SHARE = 0.9, 0.6
# Joints with a smaller range are fingers, which keep still
_SMALLEST_RANGE = 0.1
# s over which a motion grows from rest and returns to it
_RAMP = 0.5
# Sines of each joint, and sets of phases from which the one with the lowest peaks is taken
_SINES, _DRAWN = 12, 30
# s between the samples by which peaks are found
_SAMPLE = 0.005


@dataclass(frozen=True, kw_only=True)
class ExcitationSettings:
    """Settings of a motion for identification."""

    seconds: float = 10.0
    """Length of the motion, s."""
    reach: float = 0.4
    """Greatest distance of a joint from the middle of its motion, rad."""
    fastest: float = 4.0
    """Highest frequency, Hz. Slow motions cannot separate the drives' delay from their damping and the joints'
    armature: only frequencies above the drives' bandwidth do."""
    seed: int = 0
    """Seed of the phases."""

    def __post_init__(self) -> None:
        if not 2.0 <= self.seconds <= 600.0:
            raise ConfigurationError(f"a motion for identification lasts 2 to 600 s, not {self.seconds:g}")
        if not 0.0 < self.reach <= 3.2:
            raise ConfigurationError(f"the reach of a motion for identification is in (0, 3.2] rad, not {self.reach:g}")
        if not 1.0 <= self.fastest <= 0.2 / PERIOD:
            raise ConfigurationError(
                f"the highest frequency of a motion for identification is from 1 to {0.2 / PERIOD:g} Hz, not "
                f"{self.fastest:g}"
            )


class Excitation:
    """Targets of all joints over time, at rest at the beginning and the end.

    Args:
        description: of the robot.
        settings: of the motion.

    Raises:
        ConfigurationError: no joint of the robot follows positions.
    """

    def __init__(self, description: RobotDescription, settings: ExcitationSettings | None = None) -> None:
        self.settings = settings or ExcitationSettings()
        """Settings of the motion."""
        limits, home = description.limits, np.array(description.home)
        span = limits.upper - limits.lower
        driven = [
            k is JointKind.POSITION and s > 0.0 for k, s in zip(description.kinds, description.stiffness, strict=True)
        ]
        self.moved = np.flatnonzero(np.array(driven) & (span > _SMALLEST_RANGE))
        """Columns of the joints that move."""
        if not len(self.moved):
            raise ConfigurationError(f"no joint of {description.model} follows positions: nothing can be identified")
        reach = np.minimum(self.settings.reach, 0.5 * _ROOM * span)
        # Many homes are near a limit.
        middle = np.clip(home, limits.lower + reach, limits.upper - reach)
        self.middle = np.where(np.isin(np.arange(len(home)), self.moved), middle, home)
        """(J,) positions at the beginning and the end, rad or m."""
        slowest = 1.0 / self.settings.seconds
        self._rates = 2.0 * np.pi * np.geomspace(slowest, self.settings.fastest, _SINES)
        ends = (reach, *(_SHARE * each for each in (limits.velocity, limits.acceleration, limits.jerk)))
        self._phases, self._amplitudes = self._chosen(np.stack(ends)[:, self.moved])

    def targets(self, time: float) -> FloatArray:
        """Return targets (J,), rad or m, at a time from the beginning, s."""
        positions = self.middle.copy()
        positions[self.moved] += self._shape(np.array([time]), self._phases)[0] * self._amplitudes
        return positions

    def _shape(self, times: FloatArray, phases: FloatArray) -> FloatArray:
        """Return the motion (T, J) before it is scaled; phases are (J, S)."""
        left = np.minimum(times, self.settings.seconds - times)
        ramp = np.clip(left / _RAMP, 0.0, 1.0)
        # Velocity and acceleration begin and end at zero too.
        ramp = ramp**3 * (10.0 - 15.0 * ramp + 6.0 * ramp**2)
        # Between sines of equal speed, which move far too little, and of equal acceleration, which are all slow
        waves = np.sin(self._rates * times[:, None, None] + phases) / self._rates**1.5
        return ramp[:, None] * waves.sum(-1)

    def _chosen(self, ends: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return phases (J, S) and amplitudes (J,) of the largest motions.

        Args:
            ends: (4, J) ends of position, velocity, acceleration and jerk.
        """
        random = np.random.default_rng(self.settings.seed)
        times = np.arange(0.0, self.settings.seconds, _SAMPLE)
        count = ends.shape[1]
        phases, amplitudes = np.zeros((count, _SINES)), np.zeros(count)
        for _ in range(_DRAWN):
            drawn = random.uniform(0.0, 2.0 * np.pi, phases.shape)
            shape, peaks = self._shape(times, drawn), []
            for _ in range(4):
                peaks.append(np.abs(shape).max(0))
                shape = np.gradient(shape, _SAMPLE, axis=0)
            found = (ends / np.stack(peaks)).min(0)
            better = found > amplitudes
            phases[better], amplitudes[better] = drawn[better], found[better]
        return phases, amplitudes


def excite(
    link: RobotLink,
    excitation: Excitation,
    log: RobotLog,
    check: Callable[[], object] = lambda: None,
) -> None:
    """Move a robot to the middle of a motion and along it, and log its states; it rests at the end.

    Args:
        link: session with the robot's computer, with ``PERIOD`` seconds between commands.
        excitation: motion for this robot.
        log: file that gets the states of the motion.
        check: called before each command; an error that it raises ends the motion.

    Raises:
        RobotLinkError: the robot no longer answers.
        RobotFaultError: a fault stopped it.
    """
    zero = [0.0] * len(link.description.joints)
    link.move_to(excitation.middle.tolist())
    # A cycle at least, in which a robot in lockstep moves on.
    look = max(_LOOK, 1.0 / link.description.rate)
    link.wait(link.now() + look)
    link.finish_motion()
    begun, last = link.now(), -1
    # The last commands hold the middle until the drives have followed.
    for step in range(round((excitation.settings.seconds + _RAMP) / PERIOD)):
        check()
        link.send(excitation.targets(min(step * PERIOD, excitation.settings.seconds)).tolist(), zero, zero)
        while link.now() < begun + (step + 1) * PERIOD - 1e-6:
            link.wait(link.now() + look)
            state = link.state()
            if state.sequence > last and state.mode is Mode.FOLLOWING:
                log.add(state.stamp, state)
                last = state.sequence
    link.stop()
    link.finish_motion()
