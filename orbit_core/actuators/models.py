"""Actuator models that the core evaluates: efforts from targets and measured joint state, for many joints at once."""

from __future__ import annotations

import math
from collections.abc import Sequence

import torch
from torch import Tensor

from orbit_core.dynamics.indexing import columns_of
from orbit_core.interfaces import ConfigurationError, JointParameters
from orbit_core.scene import DcMotor, IdealPd

_STANDSTILL = 1e-6
"""rad/s or m/s, below which power is not looked at."""


class PdModel:
    """``effort = stiffness (q* - q) + damping (v* - v) + effort target``, limited to the joints' effort limits.

    Args:
        joints: indices (k,) of the model's joints in the scene.
        groups: the actuator group of each joint.
        parameters: of all joints of the scene.
        num_envs: N.
        device: where tensors live.
    """

    def __init__(
        self,
        joints: Sequence[int],
        groups: Sequence[IdealPd],
        parameters: JointParameters,
        num_envs: int,
        device: torch.device,
    ) -> None:
        self.joints = list(joints)
        self.columns = columns_of(self.joints, device)
        limits = torch.as_tensor(parameters.effort_limit[self.joints], dtype=torch.float32, device=device)
        self._lower, self._upper = -limits, limits
        self.stiffness = torch.tensor([group.stiffness for group in groups], device=device).repeat(num_envs, 1)
        """(N, k)"""
        self.damping = torch.tensor([group.damping for group in groups], device=device).repeat(num_envs, 1)
        """(N, k)"""

    def efforts(self, position: Tensor, velocity: Tensor, targets: Sequence[Tensor]) -> Tensor:
        """(N, k) from measured state (N, k) and position, velocity and effort targets (N, k) each."""
        position_target, velocity_target, effort_target = targets
        efforts = torch.addcmul(effort_target, self.stiffness, position_target - position)
        return self._limited(torch.addcmul(efforts, self.damping, velocity_target - velocity), velocity)

    def _limited(self, efforts: Tensor, velocity: Tensor) -> Tensor:
        return torch.clamp(efforts, self._lower, self._upper)


class DcMotorModel(PdModel):
    """A PD law through a DC motor's torque-speed line, :class:`orbit_core.scene.DcMotor`."""

    def __init__(
        self,
        joints: Sequence[int],
        groups: Sequence[DcMotor],
        parameters: JointParameters,
        num_envs: int,
        device: torch.device,
    ) -> None:
        super().__init__(joints, groups, parameters, num_envs, device)
        limits = torch.as_tensor(parameters.velocity_limit[self.joints], dtype=torch.float32, device=device)
        if not bool((torch.isfinite(limits) & (limits > 0.0)).all()):
            raise ConfigurationError(
                f"a DcMotor on joints {groups[0].joints} needs a no-load speed: set its velocity_limit"
            )
        self._saturation = torch.tensor([group.saturation_effort for group in groups], device=device)
        self._slope = self._saturation / limits
        self._zero = torch.zeros_like(limits)
        powers = [math.inf if group.power_limit is None else group.power_limit for group in groups]
        if not all(power > 0.0 for power in powers):
            raise ConfigurationError(
                f"a DcMotor on joints {groups[0].joints} has power_limit {min(powers):g} W: give a number above zero"
            )
        self._power = torch.tensor(powers, device=device)

    def _limited(self, efforts: Tensor, velocity: Tensor) -> Tensor:
        loss = self._slope * velocity
        upper = torch.clamp(self._saturation - loss, self._zero, self._upper)
        lower = torch.clamp(-self._saturation - loss, self._lower, self._zero)
        most = self._power / velocity.abs().clamp_min(_STANDSTILL)  # along the motion
        upper = torch.where(velocity > 0.0, torch.minimum(upper, most), upper)
        lower = torch.where(velocity < 0.0, torch.maximum(lower, -most), lower)
        return torch.clamp(efforts, lower, upper)
