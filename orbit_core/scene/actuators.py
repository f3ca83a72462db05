"""What drives the joints. A group of joints, chosen by regular expression, shares one model.

Gains are N m/rad and N m s/rad for revolute joints, N/m and N s/m for prismatic ones. ``None`` keeps the joint's own
value from the articulation.
"""

from __future__ import annotations

from dataclasses import dataclass

from orbit_core.scene.motors import Transmission, Windings


@dataclass(frozen=True, kw_only=True)
class ActuatorConfig:
    """A PD law on the joints whose names match one of ``joints`` (full match):

    ``effort = stiffness (position target - position) + damping (velocity target - velocity) + effort target``,
    limited to ``effort_limit``. With both gains zero the actuator is a plain motor.
    """

    joints: tuple[str, ...]
    stiffness: float = 0.0
    damping: float = 0.0
    effort_limit: float | None = None
    velocity_limit: float | None = None
    armature: float | None = None
    friction: float | None = None


@dataclass(frozen=True, kw_only=True)
class ImplicitPd(ActuatorConfig):
    """The engine's own drive, integrated with the dynamics: stable at high gains, and free of cost per step."""


@dataclass(frozen=True, kw_only=True)
class IdealPd(ActuatorConfig):
    """The PD law evaluated by the core at every physics step, as a motor controller does.

    ``min_delay`` and ``max_delay`` (physics steps) hold commands back; each environment draws its delay at reset.
    """

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

    It stands for the drive's own controller too, so that gains are left out, and velocity targets do not count. What it
    gives, and the effort target with it, is limited to ``effort_limit``. Files come from ``orbit train-actuator``.
    """

    file: str
    """Path of a file that :func:`orbit_learn.actuators.networks.write_network` wrote."""
