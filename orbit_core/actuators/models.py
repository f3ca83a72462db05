"""Actuator models: efforts from targets and measured joint state, for many joints of all environments at once.

Packages add models of their own through the entry-point group ``orbit.actuators``; an entry point is named as the class
of the groups that the model drives, and its value is the model's class::

    [project.entry-points."orbit.actuators"]
    SpringMotor = "my_package.spring_motor:SpringMotorModel"
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Hashable, Sequence
from dataclasses import dataclass
from typing import Any

import torch
from torch import Tensor

from orbit_core.dynamics.indexing import columns_of, write_rows
from orbit_core.interfaces import ConfigurationError, SceneLayout
from orbit_core.scene import DcMotor, Transmission, Windings

_DIRECT = Transmission(ratios=(1.0,))
_TINY = 1e-9
REFERENCE = 25.0
"""Degrees Celsius at which resistances are described, and of motors of which nothing is known."""
# rad/s or m/s, below which power is not looked at
_STANDSTILL = 1e-6


class Ratios:
    """Magnitudes of the ratios of k joints' transmissions; None has 1.

    A table of straight lines is its first value and a ramp for each line, so that nothing is looked up.
    """

    def __init__(self, transmissions: Sequence[Transmission | None], device: torch.device) -> None:
        tables = [transmission or _DIRECT for transmission in transmissions]
        most = max(len(table.positions) for table in tables) - 1
        starts, widths, slopes = (torch.zeros(len(tables), max(most, 1)) for _ in range(3))
        for row, table in enumerate(tables):
            positions, ratios = torch.tensor(table.positions), torch.tensor(table.ratios)
            lines = len(positions) - 1
            starts[row, :lines], widths[row, :lines] = positions[:-1], positions.diff()
            slopes[row, :lines] = ratios.diff() / positions.diff()
        self._starts, self._widths, self._slopes = (part.to(device) for part in (starts, widths, slopes))
        self._zeros = torch.zeros_like(self._widths)
        self._first = torch.tensor([table.ratios[0] for table in tables], device=device)

    def at(self, position: Tensor) -> Tensor:
        """Return (N, k) at positions (N, k) of the joints."""
        along = torch.clamp(position[..., None] - self._starts, self._zeros, self._widths)
        return (self._first + (self._slopes * along).sum(-1)).abs()


class WindingModel:
    """Temperatures of k motors in N environments; a motor without windings neither warms nor is limited."""

    def __init__(
        self, windings: Sequence[Windings | None], num_envs: int, physics_dt: float, device: torch.device
    ) -> None:
        # Numbers without effect for motors that do not warm up, so that all are computed alike.
        cold = Windings(motor_constant=1.0, thermal_resistance=1.0, time_constant=1.0)
        described = [motor or cold for motor in windings]

        def row(values: Sequence[float]) -> Tensor:
            return torch.tensor(values, dtype=torch.float32, device=device)

        self._rise_per_effort = row(
            [0.0 if w is None else w.thermal_resistance / w.motor_constant**2 for w in windings]
        )  # K over the surroundings, at rest, of a squared effort
        self._growth = row([w.resistance_rise for w in described])
        self._share = row([-math.expm1(-physics_dt / w.time_constant) for w in described])
        self.ambient = row([w.ambient for w in described])
        """(k,) degrees Celsius of what surrounds the motors."""
        self._highest = row([w.highest for w in described])
        self._span = row([w.highest - w.derating_from for w in described])
        self.temperatures = self.ambient.repeat(num_envs, 1)
        """(N, k) degrees Celsius."""

    def derating(self) -> Tensor:
        """Return (N, k) part in [0, 1] of a motor's efforts that it may give."""
        return ((self._highest - self.temperatures) / self._span).clamp(0.0, 1.0)

    def warm(self, efforts: Tensor, ratios: Tensor | None) -> None:
        """Pass one physics step in which motors exert ``efforts`` (N, k) at their joints, through ``ratios`` (N, k)."""
        # The heat is that of the motor's own effort, on its side of the transmission.
        own = efforts if ratios is None else efforts / ratios.clamp_min(_TINY)
        resistance = 1.0 + self._growth * (self.temperatures - REFERENCE)
        target = self.ambient + self._rise_per_effort * own.square() * resistance
        self.temperatures += self._share * (target - self.temperatures)


@dataclass(frozen=True)
class ActuatorContext:
    """Joints and settings that a model is built for."""

    joints: tuple[int, ...]
    """Indices (k,) of the model's joints in the scene."""
    groups: tuple[Any, ...]
    """The actuator group of each of them, an :class:`~orbit_core.scene.ActuatorConfig` of the model's class."""
    layout: SceneLayout
    """Of the scene: names, types and parameters of all joints."""
    num_envs: int
    """N."""
    device: torch.device
    """Device that tensors are made on."""

    @property
    def physics_dt(self) -> float:
        """Seconds between two evaluations."""
        return self.layout.scene.physics_dt

    @property
    def effort_limits(self) -> Tensor:
        """Effort limits (k,), N m or N, as groups or the articulation say."""
        limits = self.layout.joint_parameters.effort_limit[list(self.joints)]
        return torch.as_tensor(limits, dtype=torch.float32, device=self.device)

    def values(self, name: str) -> Tensor:
        """Return a field of the groups as a tensor (N, k) that may be written per environment."""
        numbers = [float(getattr(group, name)) for group in self.groups]
        return torch.tensor(numbers, device=self.device).repeat(self.num_envs, 1)


class ActuatorModel(ABC):
    """Computes the efforts of k joints in N environments before each physics step.

    A subclass overrides :meth:`efforts`. It keeps to what a captured step may do: tensor operations, no look at a
    tensor's values, and what lasts from step to step in :attr:`memory`, written in place.

    Args:
        context: the joints, their groups, and the scene.
    """

    def __init__(self, context: ActuatorContext) -> None:
        self.joints = list(context.joints)
        """Indices (k,) of the joints in the scene."""
        # A slice where possible: reading it is a view and no copy.
        self.columns = columns_of(self.joints, context.device)
        """The same as an index for (N, J) tensors: a slice where they are consecutive, which copies nothing."""
        self.memory: dict[str, Tensor] = {}
        """(N, ...) tensors that the model remembers, by name: part of snapshots, set to :meth:`fresh` by resets."""
        self.gains: tuple[Tensor, Tensor] | None = None
        """(N, k) stiffness and damping, where the model has such gains: events scale them, and they outlast resets."""

    @abstractmethod
    def efforts(self, position: Tensor, velocity: Tensor, targets: Sequence[Tensor]) -> Tensor:
        """Compute the efforts (N, k) of one physics step, N m or N.

        Args:
            position: (N, k) measured, rad or m.
            velocity: (N, k) measured, rad/s or m/s.
            targets: position, velocity and effort targets, (N, k) each.
        """

    @property
    def temperatures(self) -> Tensor | None:
        """Temperatures (N, k), degrees Celsius of the motors; None where the model knows of none."""
        return None

    def fresh(self, name: str) -> Tensor | float:
        """Return what a part of the memory holds when an episode begins."""
        return 0.0

    def reset(self, env_ids: Tensor | None) -> None:
        """Forget the past of some environments, by index or mask."""
        for name, value in self.memory.items():
            write_rows(value, self.fresh(name), env_ids)

    @classmethod
    def shared_by(cls, group: Any) -> Hashable:
        """Return a key: groups that agree in it share one model. All groups of a class do unless this is overridden."""
        return None


class PdModel(ActuatorModel):
    """``effort = stiffness (q* - q) + damping (v* - v) + effort target``, limited to the joints' effort limits.

    Args:
        context: joints whose groups are :class:`~orbit_core.scene.IdealPd`.
    """

    def __init__(self, context: ActuatorContext) -> None:
        super().__init__(context)
        self._upper = context.effort_limits
        # Made once, because the step is evaluated at the physics rate.
        self._lower = -self._upper
        self.stiffness, self.damping = self.gains = context.values("stiffness"), context.values("damping")
        """Gains (N, k): stiffness in N m/rad or N/m, damping in N m s/rad or N s/m."""

    def efforts(self, position: Tensor, velocity: Tensor, targets: Sequence[Tensor]) -> Tensor:
        """Return (N, k) from measured state (N, k) and position, velocity and effort targets (N, k) each."""
        position_target, velocity_target, effort_target = targets
        efforts = torch.addcmul(effort_target, self.stiffness, position_target - position)
        return self._limited(torch.addcmul(efforts, self.damping, velocity_target - velocity), velocity)

    def _limited(self, efforts: Tensor, velocity: Tensor) -> Tensor:
        return torch.clamp(efforts, self._lower, self._upper)


class DcMotorModel(PdModel):
    """A PD law through a DC motor's torque-speed line, :class:`orbit_core.scene.DcMotor`.

    Args:
        context: joints whose groups are :class:`~orbit_core.scene.DcMotor`.

    Raises:
        ConfigurationError: a motor has no no-load speed, or its power limit is not above zero.
    """

    def __init__(self, context: ActuatorContext) -> None:
        super().__init__(context)
        groups: Sequence[DcMotor] = context.groups
        parameters, device = context.layout.joint_parameters, context.device
        speeds = [
            parameters.velocity_limit[joint] if group.no_load_speed is None else group.no_load_speed
            for joint, group in zip(self.joints, groups, strict=True)
        ]
        for group, speed in zip(groups, speeds, strict=True):
            if group.transmission is not None and group.no_load_speed is None:
                raise ConfigurationError(
                    f"a DcMotor on joints {group.joints} has a transmission: set its no_load_speed, the motor's own"
                )
            if not 0.0 < speed < math.inf:
                raise ConfigurationError(
                    f"a DcMotor on joints {group.joints} needs a no-load speed above zero: set its no_load_speed, or "
                    f"its velocity_limit"
                )
        limits = torch.tensor(speeds, dtype=torch.float32, device=device)
        self._saturation = torch.tensor([group.saturation_effort for group in groups], device=device)
        self._slope = self._saturation / limits
        self._zero = torch.zeros_like(limits)
        powers = [math.inf if group.power_limit is None else group.power_limit for group in groups]
        if not all(power > 0.0 for power in powers):
            raise ConfigurationError(
                f"a DcMotor on joints {groups[0].joints} has power_limit {min(powers):g} W: give a number above zero"
            )
        self._power = torch.tensor(powers, device=device)
        through = [group.transmission for group in groups]
        self._ratios = Ratios(through, device) if any(through) else None
        self._ratio: Tensor | None = None
        windings = [group.windings for group in groups]
        self._windings = WindingModel(windings, context.num_envs, context.physics_dt, device) if any(windings) else None
        if self._windings is not None:
            self.memory["temperatures"] = self._windings.temperatures

    @property
    def temperatures(self) -> Tensor | None:
        return None if self._windings is None else self._windings.temperatures

    def fresh(self, name: str) -> Tensor | float:
        assert self._windings is not None
        return self._windings.ambient

    def efforts(self, position: Tensor, velocity: Tensor, targets: Sequence[Tensor]) -> Tensor:
        self._ratio = None if self._ratios is None else self._ratios.at(position)
        efforts = super().efforts(position, velocity, targets)
        if self._windings is not None:
            self._windings.warm(efforts, self._ratio)
        return efforts

    def _limited(self, efforts: Tensor, velocity: Tensor) -> Tensor:
        saturation, loss = self._saturation, self._slope * velocity
        if self._ratio is not None:  # the motor turns faster by the ratio, and its effort counts as much more
            saturation, loss = self._ratio * saturation, self._ratio.square() * loss
        upper = torch.clamp(saturation - loss, self._zero, self._upper)
        lower = torch.clamp(-saturation - loss, self._lower, self._zero)
        most = self._power / velocity.abs().clamp_min(_STANDSTILL)  # along the motion
        upper = torch.where(velocity > 0.0, torch.minimum(upper, most), upper)
        lower = torch.where(velocity < 0.0, torch.maximum(lower, -most), lower)
        if self._windings is not None:
            derating = self._windings.derating()
            upper, lower = derating * upper, derating * lower
        return torch.clamp(efforts, lower, upper)
