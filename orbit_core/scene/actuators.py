"""Actuators of joints: PD laws, motors, and the transmissions and windings of these.

A group of joints, chosen by regular expression, shares one model. Gains are N m/rad and N m s/rad for revolute joints,
N/m and N s/m for prismatic ones. ``None`` keeps the joint's own value from the articulation.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

# Of the tables that functions make; a ratio that doubles over its range is off by less than a thousandth between
_KNOTS = 129


@dataclass(frozen=True, kw_only=True)
class Transmission:
    """A transmission without losses whose ratio depends on the joint's position: a linkage, a crank, a cam.

    ``ratio(q)`` is the motor's velocity over the joint's; the joint's effort is the motor's times the ratio. It goes
    in straight lines between ``positions`` (rad or m of the joint, rising) and stays as it is at their ends. A ratio
    may be negative, and zero where the linkage is at a dead centre: there the motor exerts nothing on the joint.

    Args:
        positions: of the joint, one at least.
        ratios: at these.
        rotor_inertia: kg m^2 about the motor's shaft. At the joint it is ``ratio^2 rotor_inertia``; engines hold one
            reflected inertia for a joint, so that it is taken at the joint's home position, on every engine alike. What
            is left out is the change of that inertia with position, and the effort
            ``-rotor_inertia ratio ratio' velocity^2`` that belongs to it.

    Raises:
        ValueError: lengths differ, positions do not rise, or a number is not finite or negative inertia.
    """

    # One table per transmission: engines see only the ratio at home, models evaluate it at every physics step.
    positions: tuple[float, ...] = (0.0,)
    ratios: tuple[float, ...]
    rotor_inertia: float = 0.0

    def __post_init__(self) -> None:
        """Check the numbers."""
        numbers = (*self.positions, *self.ratios, self.rotor_inertia)
        if not self.positions or len(self.positions) != len(self.ratios):
            raise ValueError(f"a transmission has {len(self.positions)} positions and {len(self.ratios)} ratios")
        if not all(math.isfinite(number) for number in numbers) or self.rotor_inertia < 0.0:
            raise ValueError("a transmission's numbers must be finite, and its rotor_inertia not negative")
        if any(after <= before for before, after in zip(self.positions, self.positions[1:], strict=False)):
            raise ValueError(f"a transmission's positions must rise: {self.positions}")

    def ratio(self, position: float) -> float:
        """Return motor's velocity over the joint's at a position of the joint."""
        return float(np.interp(position, self.positions, self.ratios))


def four_bar(
    *, crank: float, coupler: float, rocker: float, ground: float, within: tuple[float, float],
    crossed: bool = False, rotor_inertia: float = 0.0,
) -> Transmission:  # fmt: skip
    """Return the transmission of a four-bar linkage: the motor turns the crank, the joint is the rocker.

    The crank turns about the origin, the rocker about (ground, 0); the joint's position is the rocker's angle from the
    x axis, towards y. With rocker end P, the crank's end is on circles about the origin and about P; the ratio
    ``rocker sin(rocker - coupler) / (crank sin(crank - coupler))``, of the three links' angles, follows from the loop's
    derivative (Norton, Design of Machinery, chapter 6). A parallelogram has 1 everywhere.

    Args:
        crank: length in m.
        coupler: length in m.
        rocker: length in m.
        ground: distance of the two axes in m.
        within: positions of the joint that it shall reach, lowest and highest, rad.
        crossed: whether the crank is on the other side of the line from the origin to P.
        rotor_inertia: kg m^2.

    Raises:
        ValueError: the linkage cannot be put together at one of these positions, or the crank is at a dead centre.
    """

    def ratio(position: float) -> float:
        x, y = ground + rocker * math.cos(position), rocker * math.sin(position)
        reach = math.hypot(x, y)
        cosine = (crank**2 + reach**2 - coupler**2) / (2.0 * crank * reach)
        # At a cosine of 1 the crank and the coupler are in line: a dead centre, where the ratio is not defined.
        if not abs(cosine) < 1.0 - 1e-9:
            raise ValueError(f"a four-bar linkage of these lengths cannot bring its rocker to {position:.4g} rad")
        turn = math.acos(cosine)
        angle = math.atan2(y, x) + (-turn if crossed else turn)
        along = math.atan2(y - crank * math.sin(angle), x - crank * math.cos(angle))
        return rocker * math.sin(position - along) / (crank * math.sin(angle - along))

    return _sampled(ratio, within, rotor_inertia)


def linear_drive(
    *, base: float, lever: float, within: tuple[float, float], offset: float = 0.0, rotor_inertia: float = 0.0
) -> Transmission:
    """Return the transmission of a linear actuator across a joint.

    The motor's position is the actuator's length in m, and its effort a force in N. The ratio is
    ``base lever sin(angle) / length``, the lever arm in m, with ``angle = position + offset``.

    Args:
        base: distance of one end of the actuator from the joint's axis, m.
        lever: distance of the other end, m.
        within: positions of the joint that it shall reach, lowest and highest, rad.
        offset: angle between the two ends where the joint's position is zero, rad.
        rotor_inertia: mass that moves with the actuator, kg.

    Raises:
        ValueError: the ends meet at one of the positions ``within`` (rad).
    """

    def ratio(position: float) -> float:
        angle = position + offset
        length = math.sqrt(base**2 + lever**2 - 2.0 * base * lever * math.cos(angle))
        if length < 1e-9:
            raise ValueError(f"the ends of a linear drive meet at {position:.4g} rad")
        return base * lever * math.sin(angle) / length

    return _sampled(ratio, within, rotor_inertia)


@dataclass(frozen=True, kw_only=True)
class Windings:
    """Heat of a motor's windings, of first order, as data sheets describe it.

    ``time_constant dT/dt = ambient + thermal_resistance heat - T``, with ``heat = (effort / motor_constant)^2 (1 +
    resistance_rise (T - 25))`` W: what the current that the effort takes loses in the copper (i^2 R). ``effort`` is the
    motor's own. The solution over a physics step is exact for the heat at its beginning. Above ``derating_from`` the
    motor's efforts are limited to a part that falls in a straight line to none at ``highest`` (maxon, Key information
    on motors; Hughes and Drury, Electric Motors and Drives). Iron and friction losses, and the housing's own slow
    warming, are left out.

    Raises:
        ValueError: a number is out of its range.
    """

    motor_constant: float
    """N m / sqrt(W), or N / sqrt(W): torque constant over the root of the winding's resistance at 25 degrees."""
    thermal_resistance: float
    """K/W from winding to surroundings."""
    time_constant: float
    """Seconds: thermal resistance times heat capacity of the winding."""
    derating_from: float = 100.0
    """Degrees Celsius."""
    highest: float = 125.0
    """Degrees Celsius."""
    ambient: float = 25.0
    """Degrees Celsius of the surroundings, and of the motor at reset."""
    resistance_rise: float = 0.0039
    """1/K, of copper."""

    def __post_init__(self) -> None:
        """Check the numbers."""
        for name in ("motor_constant", "thermal_resistance", "time_constant"):
            if not 0.0 < getattr(self, name) < math.inf:
                raise ValueError(f"{name} of windings is {getattr(self, name):g}: give a number above zero")
        # Derating divides by the difference of the last two, and falls with temperature only if they rise.
        if not -273.15 <= self.ambient < self.derating_from < self.highest < math.inf:
            raise ValueError(
                f"windings are derated from {self.derating_from:g} to {self.highest:g} degrees in surroundings of "
                f"{self.ambient:g}: these must rise"
            )
        if not 0.0 <= self.resistance_rise < math.inf:
            raise ValueError(f"resistance_rise of windings is {self.resistance_rise:g}: give none or a number above")


def _sampled(ratio: Callable[[float], float], within: tuple[float, float], rotor_inertia: float) -> Transmission:
    positions = tuple(np.linspace(*within, _KNOTS).tolist())
    return Transmission(
        positions=positions, ratios=tuple(ratio(position) for position in positions), rotor_inertia=rotor_inertia
    )


@dataclass(frozen=True, kw_only=True)
class ActuatorConfig:
    """PD law on the joints whose names match one of ``joints`` (full match).

    ``effort = stiffness (position target - position) + damping (velocity target - velocity) + effort target``,
    limited to ``effort_limit``. With both gains zero the actuator is a plain motor.
    """

    joints: tuple[str, ...]
    stiffness: float = 0.0
    """N m/rad, or N/m of joints that slide."""
    damping: float = 0.0
    """N m s/rad, or N s/m of joints that slide."""
    # None takes the value of the joint, so that one group may drive joints of different size.
    effort_limit: float | None = None
    velocity_limit: float | None = None
    """rad/s or m/s; None takes each joint's."""
    armature: float | None = None
    """Reflected inertia of the motor, kg m^2 or kg; None takes each joint's."""
    friction: float | None = None
    """Coulomb friction, N m or N; None takes each joint's."""


@dataclass(frozen=True, kw_only=True)
class ImplicitPd(ActuatorConfig):
    """The engine's own drive, integrated with the dynamics: stable at high gains, and free of cost per step."""


@dataclass(frozen=True, kw_only=True)
class IdealPd(ActuatorConfig):
    """The PD law evaluated by the core at every physics step, as a motor controller does.

    ``min_delay`` and ``max_delay`` (physics steps) hold commands back; each environment draws its delay at reset.
    """

    # Whole physics steps: an actuator is evaluated once a physics step, and holds no state in between.
    min_delay: int = 0
    max_delay: int = 0


@dataclass(frozen=True, kw_only=True)
class DcMotor(IdealPd):
    """A PD law through a DC motor's torque-speed line.

    The effort available falls linearly from ``saturation_effort`` at standstill to zero at ``velocity_limit``, and
    grows against the motion, within ``effort_limit`` (Rudin et al., Learning to Walk in Minutes, 2021, and any
    motor's data sheet). With a ``transmission`` both are the motor's own, and change with the joint's position;
    ``effort_limit`` remains the joint's.
    """

    saturation_effort: float
    no_load_speed: float | None = None
    """rad/s or m/s at which the line ends; None: the joint's velocity limit, which some engines hold joints to."""
    power_limit: float | None = None
    """W that the motor gives at most, effort times velocity along the motion; None: as much as the line allows. Braking
    is not limited by it."""
    transmission: Transmission | None = None
    """Between motor and joint; None: the motor's numbers are those at the joint."""
    windings: Windings | None = None
    """What heats up by the motor's efforts and limits them; None: nothing does."""


@dataclass(frozen=True, kw_only=True)
class ActuatorNetwork(ActuatorConfig):
    """A learned model of the actuator: effort from the error of position and the velocity, and their past.

    It includes the drive's own controller, so that gains are left out and velocity targets do not count. Its effort
    plus the effort target is limited to ``effort_limit``. Files come from ``orbit train-actuator``.
    """

    file: str
    """Path of a file that :func:`orbit_learn.actuators.networks.write_network` wrote."""
