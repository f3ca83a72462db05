"""A robot's computer: one real-time loop that drives the robot, and one client at a time that commands it.

A bridge (``orbit-zmq``, ``orbit-ros``) calls these methods from its own threads and sends what the listeners get.
"""

from __future__ import annotations

import random
import threading
from collections import deque
from collections.abc import Callable
from concurrent.futures import Future
from dataclasses import dataclass
from typing import TypeVar

import numpy as np

from orbit_core.interfaces import ConfigurationError, OrbitError
from orbit_deploy.clocks import RobotClock
from orbit_deploy.description import RobotDescription
from orbit_deploy.follower import FollowerSettings, JointFollower, JointTargets, PathKind
from orbit_deploy.hardware import Measurement, RobotHardware
from orbit_deploy.log import RobotLog
from orbit_deploy.messages import Arrangement, Fault, JointCommand, RobotState
from orbit_deploy.pictures import Picture
from orbit_deploy.realtime import RealtimeLoop

Result = TypeVar("Result")
# Seconds without any message after which a client has left
SESSION_TIMEOUT = 2.0
# Commands that wait for a cycle; of more, from a client that sends without measure, the oldest are dropped
_MOST_WAITING = 100
# Seconds in which the loop answers a request
_ANSWER = 2.0


class RobotBusyError(ConfigurationError):
    """A second client of a robot that one client commands."""


@dataclass(frozen=True, kw_only=True)
class ComputerSettings:
    """Settings of a robot's computer."""

    state_rate: float = 500.0
    """Rate at which states are handed to listeners, Hz; rounded to a divisor of the loop's rate."""
    loss: float = 0.0
    """Share of commands and states that are lost, for tests, in [0, 1)."""


class RobotComputer:
    """Loop of one robot.

    Threads of a bridge call :meth:`open`, :meth:`submit`, :meth:`move_to`, :meth:`arrange`, :meth:`stop`, :meth:`clear`
    and :meth:`leave`; the thread that calls :meth:`run` drives the robot. Listeners are called by that thread and
    return at once.

    Args:
        hardware: robot.
        motion: settings of the motion.
        settings: of the computer.
        clock: of the robot.
        log: file that gets all messages; none if None.
    """

    def __init__(
        self,
        hardware: RobotHardware,
        motion: FollowerSettings | None = None,
        settings: ComputerSettings | None = None,
        clock: RobotClock | None = None,
        log: RobotLog | None = None,
    ) -> None:
        self.hardware, self.settings = hardware, settings or ComputerSettings()
        self.description = hardware.description
        """Robot that the loop drives."""
        self.description.check()
        self.clock, self._log = clock or RobotClock(), log
        self.follower = JointFollower(self.description, motion or FollowerSettings())
        """Motion of the joints: path, limits and watchdog."""
        self.loop = RealtimeLoop(self.description.rate)
        """Clocked loop, at the robot's rate."""
        self._every = max(1, round(self.description.rate / self.settings.state_rate))
        self.on_state: list[Callable[[RobotState], None]] = []
        """Called with each state that is published."""
        self.on_fault: list[Callable[[Fault], None]] = []
        """Called with each fault."""
        self.on_picture: list[Callable[[Picture], None]] = []
        """Called with each picture of a camera, by the cameras' thread."""
        self._commands: deque[JointCommand] = deque(maxlen=_MOST_WAITING)
        self._requests: deque[Callable[[], None]] = deque()
        self._lock = threading.Lock()
        self._client = ""
        self._heard = 0
        self._cycle = 0
        self._ended = threading.Event()
        self._running = False
        self._stops_reported = 0
        self._skipped_before = 0
        self._random = random.Random(0)
        self._measured = hardware.read()
        if joint := not_finite(self._measured, self.description):
            raise ConfigurationError(f"the robot measures no finite number for {joint}: it cannot be driven")
        self.follower.rest_at(self._measured.positions)
        zero = np.zeros(len(self.description.joints))
        self._given = JointTargets(self.follower.target, zero, zero)

    # Called by a bridge

    @property
    def client(self) -> str:
        """Name of the client that commands; empty if there is none."""
        return self._client

    def open(self, client: str, period: float, path: PathKind = PathKind.QUINTIC) -> RobotState:
        """Begin a client's session.

        Args:
            client: its name.
            period: seconds between its commands.
            path: way in which its commands become a path.

        Raises:
            RobotBusyError: another client has a session.
            ConfigurationError: the period is longer than a second or shorter than the robot's own.
        """
        if not 0.9 / self.description.rate <= period <= 1.0:
            raise ConfigurationError(
                f"a client commands at 1 to {self.description.rate:g} Hz, not every {period:g} s: set its rate"
            )
        # Two bridges, or two threads of one, may ask at once.
        with self._lock:
            if self._client and self._client != client:
                raise RobotBusyError(f"client {self._client} commands the robot: stop it, then connect again")
            self._client, self._heard = client, self.clock.now()
        # What the client before has sent is not this one's.
        self._commands.clear()
        return self._answer(lambda: self._begin(period, path))

    def heard(self) -> None:
        """Note that the client of the session is alive."""
        self._heard = self.clock.now()

    def submit(self, command: JointCommand) -> None:
        """Hand a command of the session's client to the loop; returns at once."""
        self.heard()
        if not self.settings.loss or self._random.random() >= self.settings.loss:
            self._commands.append(command)

    def move_to(self, positions: list[float]) -> RobotState:
        """Begin a slow motion to positions (J,), rad or m; its end is seen in the state's mode."""
        return self._answer(lambda: self._moving(positions))

    def arrange(self, arrangement: Arrangement) -> RobotState:
        """Put a simulated robot or an object somewhere.

        Raises:
            OrbitError: the robot is a real one, or there is no such object.
        """
        return self._answer(lambda: self._arranged(arrangement))

    def clear(self) -> RobotState:
        """Clear a fault."""
        return self._answer(lambda: self._cleared())

    def stop(self) -> None:
        """Stop the robot within limits, at anybody's request."""
        self._requests.append(self.follower.stop)

    def leave(self, client: str) -> None:
        """End a client's session; the robot stops."""
        with self._lock:
            if self._client == client:
                self._client = ""
                self._requests.append(self.follower.stop)

    def end(self) -> None:
        """Have :meth:`run` bring the robot to rest and return."""
        self._ended.set()

    def watch(self) -> None:
        """Start the robot's cameras; once, before the loop runs.

        Raises:
            OrbitError: they cannot be started.
        """
        self.hardware.watch(self._show, self.clock.now)

    def _show(self, picture: Picture) -> None:
        for listener in self.on_picture:
            listener(picture)

    # The loop

    def run(self) -> None:
        """Drive the robot until :meth:`end`, then until it rests.

        Raises:
            OrbitError: the robot failed.
        """
        self._running = True
        try:
            self.loop.run(self.cycle, lambda: not self._ended.is_set())
            self.follower.stop()
            # A stop takes less than a second; a robot that does not rest by then has failed.
            left = [round(3.0 * self.description.rate)]

            def moving() -> bool:
                left[0] -= 1
                return left[0] > 0 and not self.follower.limiter.at_rest

            RealtimeLoop(self.description.rate).run(self.cycle, moving)
        finally:
            self._running = False
            if self._log is not None:
                self._log.close()

    def cycle(self) -> None:
        """Run one cycle: requests, commands, targets, measurement."""
        while self._requests:
            self._requests.popleft()()
        now, accepted = self.clock.now(), self.follower.accepted
        while self._commands:
            self._take(self._commands.popleft(), now)
        if self.loop.skipped != self._skipped_before:
            # The drives have held the last target all the while, so that the motion begins again from rest.
            held, self._skipped_before = self.loop.skipped - self._skipped_before, self.loop.skipped
            self.follower.rest_at(self.follower.target)
            self._report(Fault(now, "overrun", f"the robot's loop was held up for {held} cycles: it begins from rest"))
        if self._client and now - self._heard > SESSION_TIMEOUT * 1e9:
            self._forget_client(now)
        targets = self._given = self.follower.sample(now)
        stops = self.follower.stops
        try:
            self.hardware.drive(targets)
        except (OrbitError, OSError) as error:
            self._report(Fault(now, "robot", f"the robot failed: {' '.join(str(error).split())}"))
            raise
        self._cycle += 1
        if stops != self._stops_reported:
            self._stops_reported = stops
            self._report(Fault(now, "watchdog", "no command arrived in time: the robot stops"))
        # A command is acknowledged at once, which a client measures its round trip by.
        if self._cycle % self._every == 0 or self.follower.accepted != accepted:
            self._publish(self._present())

    def _take(self, command: JointCommand, now: int) -> None:
        if self._log is not None:
            self._log.add(now, command)
        fault = self.follower.submit(command, now)
        if fault is not None:
            self._report(fault)

    def _begin(self, period: float, path: PathKind) -> RobotState:
        self.follower.begin(period, path)
        self._stops_reported = 0
        return self._present()

    def _moving(self, positions: list[float]) -> RobotState:
        fault = self.follower.move_to(positions, self.clock.now())
        if fault is not None:
            self._report(fault)
        return self._present()

    def _arranged(self, arrangement: Arrangement) -> RobotState:
        numbers = [*(arrangement.positions or ()), *(arrangement.pose or ())]
        if not np.isfinite(numbers).all():
            raise ConfigurationError("an arrangement holds a number that is not finite")
        if arrangement.positions is not None and len(arrangement.positions) != len(self.description.joints):
            raise ConfigurationError(
                f"an arrangement gives {len(arrangement.positions)} joint positions, not {len(self.description.joints)}"
            )
        if arrangement.pose is not None and len(arrangement.pose) != 7:
            raise ConfigurationError(f"a pose has 7 numbers, not {len(arrangement.pose)}")
        measured = self.hardware.arrange(arrangement)
        if arrangement.reset or arrangement.positions is not None:
            self.follower.rest_at(measured.positions)
        return self._state(measured)

    def _cleared(self) -> RobotState:
        self.follower.clear()
        return self._present()

    def _forget_client(self, now: int) -> None:
        with self._lock:
            gone, self._client = self._client, ""
        self.follower.stop()
        self._report(Fault(now, "watchdog", f"client {gone} has gone without a word: the robot stops"))

    def _present(self) -> RobotState:
        return self._state(self.hardware.read())

    def _state(self, measured: Measurement) -> RobotState:
        follower, now = self.follower, self.clock.now()
        if joint := not_finite(measured, self.description):
            # A client would act on it, so that it gets the last numbers that were some, and the fault.
            measured = self._measured
            if follower.fault is None:
                fault = Fault(now, "nan", f"the robot measures no finite number for {joint}")
                follower.stop(fault)
                self._report(fault)
        self._measured = measured
        follower.measured = measured.positions
        return RobotState(
            sequence=self._cycle,
            stamp=now,
            mode=follower.mode,
            command=follower.accepted,
            age=follower.age(now),
            positions=measured.positions.tolist(),
            velocities=measured.velocities.tolist(),
            efforts=measured.efforts.tolist(),
            targets=follower.target.tolist(),
            target_velocities=self._given.velocities.tolist(),
            target_efforts=self._given.efforts.tolist(),
            objects=measured.objects,
            clamped=follower.clamped,
            limited=follower.limited,
            late=follower.late,
            stops=follower.stops,
            imus=measured.imus,
        )

    def _publish(self, state: RobotState) -> None:
        if self._log is not None:
            self._log.add(state.stamp, state)
        if not self.settings.loss or self._random.random() >= self.settings.loss:
            for listener in self.on_state:
                listener(state)

    def _report(self, fault: Fault) -> None:
        if self._log is not None:
            self._log.add(fault.stamp, fault)
        for listener in self.on_fault:
            listener(fault)

    def _answer(self, request: Callable[[], Result]) -> Result:
        """Have the loop's thread compute something between two cycles, and return or raise what it did."""
        future: Future[Result] = Future()

        def answer() -> None:
            try:
                future.set_result(request())
            except OrbitError as error:
                future.set_exception(error)

        if not self._running:
            # Nobody else drives the robot.
            return request()
        self._requests.append(answer)
        try:
            return future.result(_ANSWER)
        except TimeoutError:
            raise ConfigurationError(f"the robot's loop has not answered within {_ANSWER:g} s: does it run?") from None


def not_finite(measured: Measurement | RobotState, description: RobotDescription) -> str:
    """Return the name of a joint, object or inertial unit with a number that is none; empty if all are.

    Args:
        measured: to check.
        description: of the robot.
    """
    rows = np.array((measured.positions, measured.velocities, measured.efforts))
    if not np.isfinite(rows).all():
        return f"joint {description.joints[int(np.argmin(np.isfinite(rows).all(0)))]}"
    for names, tables in ((description.objects, measured.objects), (description.imus, measured.imus)):
        for name, numbers in zip(names, tables, strict=False):
            if not np.isfinite(numbers).all():
                return f"'{name}'"
    return ""
