"""Joint targets at the robot's rate from commands at a client's: checks, interpolation, limits and watchdog."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum

import numpy as np

from orbit_core.interfaces import ConfigurationError
from orbit_deploy.description import FloatArray, JointKind, RobotDescription
from orbit_deploy.limiter import MotionLimiter
from orbit_deploy.messages import Fault, JointCommand, Mode
from orbit_deploy.playout import CommandPath, DriveResponse, QuinticPlayout

_NANO = 1e-9
# rad or m by which limits hold a joint back noticeably
_HELD_BACK = 0.05
# Share of a command that may miss a limit by rounding
_ROUNDING = 1e-5


class PathKind(StrEnum):
    """Way in which a client's commands become a path."""

    QUINTIC = "quintic"
    """Through the commands by quintic polynomials, one period later: for planned motions and stiff drives."""
    DRIVE = "drive"
    """As the drives of the description would move the joints: for policies that were trained with these."""
    DIRECT = "direct"
    """To the drives as they come, within limits of position, velocity and effort only; where the robot permits it."""


@dataclass(frozen=True, kw_only=True)
class FollowerSettings:
    """Settings of how commands become motion."""

    jitter: float = 0.004
    """Seconds by which a command may be late without being noticed; the path is played out that much later."""
    watchdog: float = 0.06
    """Seconds without a command after which the robot stops; at least two and a half periods of the client."""
    jump: float = 1.0
    """Seconds: a target that the joint could not reach in this time at full speed is a jump, and rejected."""
    clock_jump: float = 0.5
    """Seconds by which a stamp may differ from the robot's clock."""
    moving_speed: float = 0.2
    """Share of the velocity limits at soft starts and ways home, in (0, 1]."""

    def __post_init__(self) -> None:
        for name in ("jitter", "watchdog", "jump", "clock_jump", "moving_speed"):
            value = getattr(self, name)
            if not 0.0 < value < 60.0:
                raise ConfigurationError(f"setting '{name}' of the robot must be above 0 and below 60, not {value}")
        if self.moving_speed > 1.0:
            raise ConfigurationError(
                f"setting 'moving_speed' is a share of the limits, in (0, 1], not {self.moving_speed}"
            )


@dataclass(frozen=True)
class JointTargets:
    """Targets (J,) of one cycle, within all limits."""

    positions: FloatArray
    """rad or m; velocity-driven joints have none to reach, and here the integral of their velocity."""
    velocities: FloatArray
    """rad/s or m/s for the drives: as commanded; of velocity-driven joints as limited."""
    efforts: FloatArray
    """N m or N added to the drives'."""


class JointFollower:
    """Motion of one robot, cycle by cycle; free of clocks, threads and sockets.

    Commands are checked when they are submitted. One that cannot be meant (NaN, another number of joints, a stamp far
    from the robot's clock, beyond twice a limit, a jump) is refused and stops the robot within its limits, until
    :meth:`clear`. Missing commands stop it too, and the next command continues from where it rests.

    Args:
        description: of the robot.
        settings: of the motion.
    """

    def __init__(self, description: RobotDescription, settings: FollowerSettings) -> None:
        self.description, self.settings, self.limits = description, settings, description.limits
        """The description's limits as arrays (J,)."""
        self.period = 1.0 / description.rate
        """Seconds of a cycle."""
        kinds = np.array(description.kinds)
        self._driven, self._efforts_only = kinds == JointKind.VELOCITY, kinds == JointKind.EFFORT
        self.limiter = MotionLimiter(self.limits, self.period, self._driven)
        """Limiter that turns the commanded path into targets within all limits."""
        self._range = np.maximum(self.limits.upper - self.limits.lower, 0.0)
        home = np.array(description.home)
        self._path_kind = PathKind.QUINTIC
        self._path: CommandPath = QuinticPlayout(home, settings.jitter, 0.0, self.limits.acceleration)
        self.mode = Mode.HOLDING
        """Present activity of the robot."""
        self.accepted = -1
        """Sequence number of the newest command that was accepted; -1 before the first of a session."""
        self.clamped = 0
        """Commands that were clamped to limits."""
        self.limited = 0
        """Cycles in which the limits kept the joints from the path by more than 0.05 rad or m."""
        self.late = 0
        """Commands that arrived more than a period and the jitter after their stamp."""
        self.stops = 0
        """Stops for want of commands."""
        self.measured = home
        """Newest measured positions (J,), from which direct commands are judged and stopped."""
        self.fault: Fault | None = None
        """Fault that stopped the robot; None once it is cleared."""
        self._arrived = 0.0
        self._stamp = -np.inf
        self._watchdog, self._patience = settings.watchdog, settings.jitter
        self._destination = home
        self._velocities = self._efforts = np.zeros_like(home)
        self._wanted_velocities = self._wanted_efforts = self._efforts
        self._wanted_positions = home
        self.rest_at(home)

    # Sessions

    def begin(self, period: float, path: PathKind = PathKind.QUINTIC) -> None:
        """Begin a session.

        Args:
            period: seconds between the client's commands.
            path: way in which its commands become a path.

        Raises:
            ConfigurationError: the robot takes no direct commands.
        """
        # A new client counts from zero, by a clock that it has just measured.
        self.accepted, self._stamp = -1, -np.inf
        self.clamped = self.limited = self.late = self.stops = 0
        self._watchdog = max(self.settings.watchdog, 2.5 * period)
        here, limits = self.limiter.position, self.limits
        if path is PathKind.DIRECT and not self.description.direct:
            raise ConfigurationError(
                f"the robot {self.description.model} takes no direct commands, whose accelerations nobody limits: use "
                "path 'quintic' or 'drive', or have its computer permit them"
            )
        if path is PathKind.DRIVE:
            stiffness, damping = np.array(self.description.stiffness), np.array(self.description.damping)
            # Joints without a drive of their own, as those that mimic others, are at their target in a cycle.
            rates = np.divide(stiffness, damping, out=np.full_like(damping, 1.0 / self.period), where=damping > 0.0)
            self._path = DriveResponse(here, 0.0, rates)
        else:
            self._path = QuinticPlayout(here, period + self.settings.jitter, period, limits.acceleration)
        self._path_kind, self._patience = path, period + self.settings.jitter
        self.clear()

    def clear(self) -> None:
        """Clear a fault; the robot keeps its place until the next command."""
        self.fault = None
        if self.mode is Mode.FAULT:
            self.mode = Mode.HOLDING

    def rest_at(self, positions: FloatArray) -> None:
        """Continue at rest from measured positions (J,), as at the start of the robot."""
        self.measured = positions
        self.limiter.reset(positions)
        self._path.restart(self.limiter.position)
        self._velocities = self._efforts = np.zeros_like(self.limiter.position)
        self.mode = Mode.HOLDING if self.fault is None else Mode.FAULT

    # Requests

    def submit(self, command: JointCommand, now: int) -> Fault | None:
        """Take a command.

        Args:
            command: of the client.
            now: ns on the robot's clock.

        Returns:
            The fault that stops the robot, or None.
        """
        # A command that was sent before the client knew of a fault must not be one more fault.
        if command.sequence <= self.accepted or self.fault is not None:
            return None
        checked = self._checked(command, now)
        if isinstance(checked, Fault):
            self.stop(checked)
            return checked
        stamp = command.stamp * _NANO
        if stamp <= self._stamp:
            return self._refuse(now, "time", f"command {command.sequence} is stamped before the one it follows")
        positions, self._wanted_velocities, self._wanted_efforts = checked
        self._wanted_positions = positions
        if self.mode is not Mode.FOLLOWING:
            # A path that begins where the robot is, as it may have stopped elsewhere.
            self._path.restart(self.limiter.position)
        if stamp + self._patience < now * _NANO:
            self.late += 1
        self._path.add(stamp, positions)
        self.accepted, self._stamp, self._arrived, self.mode = command.sequence, stamp, now * _NANO, Mode.FOLLOWING
        return None

    def move_to(self, positions: list[float], now: int) -> Fault | None:
        """Begin to move slowly to positions (J,), each joint on its own; :attr:`mode` is MOVING until it rests there.

        Args:
            positions: rad or m, clamped to the limits.
            now: ns on the robot's clock.

        Returns:
            The fault that stops the robot, or None.
        """
        goal = np.asarray(positions, np.float64)
        if goal.shape != self.limits.lower.shape or not np.isfinite(goal).all():
            return self._refuse(now, "nan", "positions to move to are no finite numbers, one for each joint")
        if self.fault is None:
            self._destination = np.clip(goal, self.limits.lower, self.limits.upper)
            self.mode = Mode.MOVING
        return None

    def stop(self, fault: Fault | None = None) -> None:
        """Stop within limits; with a fault, refuse commands until :meth:`clear`."""
        self.fault = fault or self.fault
        if self.mode is Mode.FOLLOWING and self._path_kind is PathKind.DIRECT:
            # The last command may be far from the joints: the drives' damping stops them where they are.
            self.limiter.reset(self.measured)
        if self.mode not in (Mode.FAULT, Mode.HOLDING) or not self.limiter.at_rest:
            self.mode = Mode.STOPPING
        elif self.fault is not None:
            self.mode = Mode.FAULT

    # Cycles

    def sample(self, now: int) -> JointTargets:
        """Compute the targets of one cycle.

        Args:
            now: time of the cycle on the robot's clock, ns.
        """
        if self.mode is Mode.FOLLOWING and now * _NANO - self._arrived > self._watchdog:
            self.stops += 1
            self.stop()
        if self.mode is Mode.FOLLOWING and self._path_kind is PathKind.DIRECT:
            return JointTargets(self._wanted_positions, self._wanted_velocities, self._wanted_efforts)
        if self.mode is Mode.FOLLOWING:
            position, velocity, acceleration = self._path.sample(now * _NANO)
            velocity = np.where(self._driven, self._wanted_velocities, velocity)
            self.limiter.follow(position, velocity, np.where(self._driven, 0.0, acceleration))
            apart = np.abs(position - self.limiter.position)[~self._driven].max(initial=0.0)
            self.limited += bool(apart > _HELD_BACK)
            self._velocities, wanted = self._wanted_velocities, self._wanted_efforts
        elif self.mode is Mode.MOVING:
            zero = np.zeros_like(self._destination)
            self.limiter.follow(self._destination, zero, zero, self.settings.moving_speed)
            self._velocities, wanted = zero, zero
            # Joints that are driven by velocity have no place to reach.
            there = np.abs(self._destination - self.limiter.position)[~self._driven].max(initial=0.0) < 1e-6
            if there and self.limiter.at_rest:
                self.mode = Mode.HOLDING
        else:
            if not self.limiter.at_rest:
                self.limiter.brake()
            elif self.mode is Mode.STOPPING:
                self.mode = Mode.HOLDING if self.fault is None else Mode.FAULT
            self._velocities = wanted = np.zeros_like(self._destination)
        # A step of effort would be one of acceleration, which no path of positions limits.
        step = self.limits.effort_rate * self.period
        self._efforts = np.clip(wanted, self._efforts - step, self._efforts + step)
        velocities = np.where(self._driven, self.limiter.velocity, self._velocities)
        if self._path_kind is PathKind.DRIVE:
            # The path has the drives' lag already, so that the drives must not add it again.
            velocities = velocities + np.where(self._driven, 0.0, self.limiter.velocity)
        return JointTargets(self.limiter.position, velocities, self._efforts)

    @property
    def target(self) -> FloatArray:
        """Positions (J,) that the drives were given last, rad or m."""
        direct = self.mode is Mode.FOLLOWING and self._path_kind is PathKind.DIRECT
        return self._wanted_positions if direct else self.limiter.position

    def age(self, now: int) -> float:
        """Return seconds since the last command arrived; infinite before the first."""
        return now * _NANO - self._arrived if self.accepted >= 0 else float("inf")

    # Checks

    def _checked(self, command: JointCommand, now: int) -> tuple[FloatArray, FloatArray, FloatArray] | Fault:
        """Return positions, velocities and efforts (J,) within limits, or the fault."""
        number, names, limits = command.sequence, self.description.joints, self.limits
        if any(len(values) != len(names) for values in (command.positions, command.velocities, command.efforts)):
            return Fault(now, "shape", f"command {number} is not for the robot's {len(names)} joints")
        values = np.array((command.positions, command.velocities, command.efforts), np.float64)
        if not np.isfinite(values).all():
            joint = names[int(np.argmin(np.isfinite(values).all(0)))]
            return Fault(now, "nan", f"command {number} is no finite number for joint {joint}")
        # A stamp far off is a clock that jumped, or another robot's: interpolation would stretch or fold the path.
        off = command.stamp * _NANO - now * _NANO
        if abs(off) > self.settings.clock_jump:
            return Fault(now, "time", f"command {number} is stamped {off:+.3f} s off the robot's clock")
        positions, velocities, efforts = values
        # Only drives of positions have a position to reach.
        positions = np.where(self._driven | self._efforts_only, self.limiter.position, positions)
        beyond = np.maximum(positions - limits.upper, limits.lower - positions)
        for what, excess, most, unit in (
            ("a position", beyond, self._range, "beyond its range"),
            ("a velocity", np.abs(velocities) - limits.velocity, limits.velocity, "above its limit"),
            ("an effort", np.abs(efforts) - limits.effort, limits.effort, "above its limit"),
        ):
            worst = int(np.argmax(excess - most))
            if excess[worst] > most[worst]:
                return Fault(
                    now,
                    "limit",
                    f"command {number} sends {what} to joint {names[worst]} that is {excess[worst]:.4g} {unit}, more "
                    "than twice what it allows",
                )
            if (excess > _ROUNDING * np.where(np.isfinite(most), most, 1.0)).any():
                self.clamped += 1
        # Direct targets are far ahead of the joints on purpose, so that they are judged from the joints themselves.
        here = self.measured if self._path_kind is PathKind.DIRECT else self.limiter.position
        leap = np.abs(np.clip(positions, limits.lower, limits.upper) - here)
        far = leap - limits.velocity * self.settings.jump
        if (worst := int(np.argmax(far))) >= 0 and far[worst] > 0.0:
            return Fault(
                now,
                "jump",
                f"command {number} is {leap[worst]:.3g} from where joint {names[worst]} is, more than it can move in "
                f"{self.settings.jump:g} s: move there slowly first",
            )
        return (
            np.clip(positions, limits.lower, limits.upper),
            np.clip(velocities, -limits.velocity, limits.velocity),
            np.clip(efforts, -limits.effort, limits.effort),
        )

    def _refuse(self, now: int, code: str, text: str) -> Fault:
        fault = Fault(now, code, text)
        self.stop(fault)
        return fault
