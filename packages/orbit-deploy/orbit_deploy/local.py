"""A link to a robot's computer in the same process, in lockstep: its time passes only while the client waits."""

from __future__ import annotations

from collections.abc import Sequence

from orbit_deploy.clocks import ClockOffset, Latencies, RobotClock
from orbit_deploy.computer import ComputerSettings, RobotComputer
from orbit_deploy.follower import FollowerSettings, PathKind
from orbit_deploy.hardware import RobotHardware
from orbit_deploy.link import RobotLink, fault_error
from orbit_deploy.messages import PASSING, Arrangement, Fault, JointCommand, RobotState
from orbit_deploy.pictures import CameraDescription, Picture, PictureBox, PictureKind

# ns that the clock starts at, so that no time is negative
_EPOCH = 10**9


class LockstepClock(RobotClock):
    """Clock that moves only when it is set."""

    time: int = _EPOCH
    """ns"""

    def now(self) -> int:
        return self.time

    def set(self, time: int) -> None:
        """Set the time, ns."""
        object.__setattr__(self, "time", time)


class LocalLink(RobotLink):
    """Session with a robot's computer that this link steps itself: as fast as the machine allows, and repeatable.

    For studies of what limits, interpolation and imperfections of the robot do to a policy, without real time.

    Args:
        hardware: robot, which the link closes.
        period: seconds between commands.
        motion: settings of the motion.
        settings: of the computer.
        path: way in which commands become a path.
    """

    def __init__(
        self,
        hardware: RobotHardware,
        period: float,
        motion: FollowerSettings | None = None,
        settings: ComputerSettings | None = None,
        path: PathKind = PathKind.QUINTIC,
    ) -> None:
        self._clock = LockstepClock()
        self.computer = RobotComputer(hardware, motion, settings, self._clock)
        """Computer that each step of the link runs for one period."""
        self.address = "local"
        self.description = self.computer.description
        """Robot as the computer describes it."""
        self.offset, self.round_trips, self.ages = ClockOffset(), Latencies(), Latencies()
        self.pictures = PictureBox()
        self._faults: list[Fault] = []
        self.computer.on_state.append(self._take)
        self.computer.on_fault.append(self._note)
        self._period = round(1e9 / self.description.rate)
        self._sequence = 0
        self._state = self.computer.open("local", period, path)

    def send(self, positions: Sequence[float], velocities: Sequence[float], efforts: Sequence[float]) -> None:
        targets = (list(values) for values in (positions, velocities, efforts))
        self.computer.submit(JointCommand(self._sequence, self._clock.now(), *targets))
        self._sequence += 1

    def state(self) -> RobotState:
        if self._faults:
            raise fault_error(self._faults.pop(0), self.address)
        return self._state

    def picture(self, camera: CameraDescription, kind: PictureKind, since: int = 0) -> Picture:
        # Drawn when it is looked at, so that the same run sees the same pictures.
        return self.computer.hardware.look(camera.name, kind, self._clock.now())

    def move_to(self, positions: Sequence[float]) -> RobotState:
        return self._keep(self.computer.move_to(list(positions)))

    def arrange(self, arrangement: Arrangement) -> RobotState:
        return self._keep(self.computer.arrange(arrangement))

    def clear(self) -> RobotState:
        return self._keep(self.computer.clear())

    def stop(self) -> None:
        self.computer.stop()

    def close(self) -> None:
        self.computer.leave("local")
        self.computer.hardware.close()

    def now(self) -> float:
        return 1e-9 * self._clock.now()

    def wait(self, until: float) -> None:
        # Rounded, as the time is a sum of periods.
        for _ in range(round((until - self.now()) * self.description.rate)):
            self._clock.set(self._clock.now() + self._period)
            self.computer.heard()
            self.computer.cycle()

    def _keep(self, state: RobotState) -> RobotState:
        self._state = state
        return state

    def _take(self, state: RobotState) -> None:
        self._state = state

    def _note(self, fault: Fault) -> None:
        if fault.code not in PASSING:
            self._faults.append(fault)
