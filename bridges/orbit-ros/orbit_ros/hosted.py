"""Link to a robot whose computer knows no sessions: our own one runs in this process and keeps the limits."""

from __future__ import annotations

import threading
import time
from collections.abc import Sequence

from orbit_core.interfaces import OrbitError
from orbit_deploy.clocks import ClockOffset, Latencies, RobotClock
from orbit_deploy.computer import ComputerSettings, RobotComputer
from orbit_deploy.follower import FollowerSettings, PathKind
from orbit_deploy.hardware import RobotHardware
from orbit_deploy.link import RobotLink, RobotLinkError, fault_error
from orbit_deploy.messages import Arrangement, Fault, JointCommand, RobotState
from orbit_deploy.pictures import PictureBox

_CLIENT = "this process"
# Seconds without a cycle after which the loop has failed
_LOST = 0.5
# Seconds between looks at a clock that the robot publishes
_TICK = 0.001


class HostedLink(RobotLink):
    """Session with a robot's computer that runs in a thread of this process.

    Limits, interpolation and watchdog are those of every robot; they end with this process, after which the robot's
    own drivers have to bring it to rest.

    Args:
        hardware: robot, which the link closes.
        address: for messages.
        period: seconds between commands.
        path: way in which commands become a path.
    """

    def __init__(self, hardware: RobotHardware, address: str, period: float, path: PathKind = PathKind.QUINTIC) -> None:
        self.address, self.description = address, hardware.description
        """Robot as its hardware describes it."""
        self.offset, self.round_trips, self.ages = ClockOffset(), Latencies(), Latencies()
        self.pictures = PictureBox()
        self._hardware, self._error, self._sequence = hardware, "", 0
        self._faults: list[Fault] = []
        self._sent: tuple[int, float] = (-1, 0.0)
        settings = ComputerSettings(state_rate=hardware.description.rate)
        # The threads of ROS and of the policy share Python's lock with the loop: a late command is no lost link.
        watchdog = max(0.1, 3.0 * period)
        self._clock = hardware.clock or RobotClock()
        self.computer = RobotComputer(hardware, FollowerSettings(watchdog=watchdog), settings, self._clock)
        """Computer that a thread of this process runs."""
        self.computer.on_state.append(self._take)
        self.computer.on_fault.append(self._note)
        self.computer.on_picture.append(self.pictures.put)
        self.computer.watch()
        self._state = self.computer.open(_CLIENT, period, path)
        self._arrived = time.monotonic()
        # The same clock on both sides
        now = time.monotonic_ns()
        self.offset.add(now, now, now)
        self._thread = threading.Thread(target=self._run, name="robot's computer", daemon=True)
        self._thread.start()

    def send(self, positions: Sequence[float], velocities: Sequence[float], efforts: Sequence[float]) -> None:
        targets = (list(values) for values in (positions, velocities, efforts))
        self._sent = (self._sequence, time.monotonic())
        self.computer.submit(JointCommand(self._sequence, self.computer.clock.now(), *targets))
        self._sequence += 1

    def state(self) -> RobotState:
        if self._error:
            raise RobotLinkError(f"the robot at {self.address} has failed: {self._error}")
        if self._faults:
            raise fault_error(self._faults.pop(0), self.address)
        age = time.monotonic() - self._arrived
        if age > _LOST:
            raise RobotLinkError(f"the loop of the robot at {self.address} has not run for {age:.2f} s")
        self.ages.add(age)
        return self._state

    def move_to(self, positions: Sequence[float]) -> RobotState:
        return self.computer.move_to(list(positions))

    def arrange(self, arrangement: Arrangement) -> RobotState:
        return self.computer.arrange(arrangement)

    def clear(self) -> RobotState:
        self._faults.clear()
        return self.computer.clear()

    def stop(self) -> None:
        self.computer.stop()

    def close(self) -> None:
        self.computer.leave(_CLIENT)
        self.computer.end()
        self._thread.join(5.0)
        self._hardware.close()

    def now(self) -> float:
        return super().now() if self._hardware.clock is None else 1e-9 * self._clock.now()

    def wait(self, until: float) -> None:
        if self._hardware.clock is None:
            super().wait(until)
            return
        # A clock that stands still is a failure of the robot, which its loop reports.
        while 1e-9 * self._clock.now() < until and not self._error:
            time.sleep(_TICK)

    def _run(self) -> None:
        try:
            self.computer.run()
        except (OrbitError, OSError) as error:
            self._error = str(error)

    def _take(self, state: RobotState) -> None:
        # A process that hangs sends no commands, which the watchdog notices.
        self.computer.heard()
        self._state, self._arrived = state, time.monotonic()
        number, sent = self._sent
        if number >= 0 and state.command >= number:
            self.round_trips.add(self._arrived - sent)
            self._sent = (-1, 0.0)

    def _note(self, fault: Fault) -> None:
        # While an environment is built, Python's lock holds the loop up: the robot rests as without commands.
        if fault.code not in ("watchdog", "overrun"):
            self._faults.append(fault)
