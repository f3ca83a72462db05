"""Actuator models that the core evaluates: efforts from targets and measured joint state, for many joints at once."""

from __future__ import annotations

import math
from collections.abc import Sequence

import torch
from torch import Tensor

from orbit_core.actuators.model import ActuatorContext, ActuatorModel
from orbit_core.actuators.motors import Ratios, WindingModel
from orbit_core.interfaces import ConfigurationError
from orbit_core.scene import DcMotor

_STANDSTILL = 1e-6
"""rad/s or m/s, below which power is not looked at."""


class PdModel(ActuatorModel):
    """``effort = stiffness (q* - q) + damping (v* - v) + effort target``, limited to the joints' effort limits.

    Args:
        context: joints whose groups are :class:`~orbit_core.scene.IdealPd`.
    """

    def __init__(self, context: ActuatorContext) -> None:
        super().__init__(context)
        self._upper = context.effort_limits
        self._lower = -self._upper
        self.stiffness, self.damping = self.gains = context.values("stiffness"), context.values("damping")

    def efforts(self, position: Tensor, velocity: Tensor, targets: Sequence[Tensor]) -> Tensor:
        """(N, k) from measured state (N, k) and position, velocity and effort targets (N, k) each."""
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
