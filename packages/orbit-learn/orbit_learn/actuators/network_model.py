"""Actuator networks at run time: one network for some joints of all environments."""

from __future__ import annotations

from collections.abc import Hashable, Sequence
from pathlib import Path

import torch
from torch import Tensor

from orbit_core.actuators.models import ActuatorContext, ActuatorModel
from orbit_core.interfaces import ConfigurationError
from orbit_core.scene import ActuatorNetwork, JointType
from orbit_learn.actuators.networks import check_rate, read_network


class NetworkModel(ActuatorModel):
    """Efforts (N, k) of the joints that share an actuator network's file.

    Args:
        context: joints whose groups are :class:`~orbit_core.scene.ActuatorNetwork`, of one file.

    Raises:
        ConfigurationError: the file cannot be read; or the network is of another rate, or for joints of another unit.
    """

    def __init__(self, context: ActuatorContext) -> None:
        super().__init__(context)
        file, layout, num_envs, device = context.groups[0].file, context.layout, context.num_envs, context.device
        self._network = read_network(Path(file)).to(device)
        description = self._network.description
        check_rate(file, description, layout.scene.physics_dt)
        for joint in self.joints:
            unit = "m" if layout.joints[joint].type is JointType.PRISMATIC else "rad"
            if unit != description.unit:
                raise ConfigurationError(
                    f"actuator network {file} is of joints whose positions are in {description.unit}, and those of "
                    f"joint '{layout.joints[joint].name}' are in {unit}: fit one to such joints"
                )
        self._size = (num_envs, len(self.joints))
        self.past = self._network.past(num_envs * len(self.joints), device)
        """(depth, N k, ...) what the network remembers."""
        self.memory["past"] = self.past.unflatten(1, self._size).transpose(0, 1)
        self._upper = context.effort_limits
        self._lower = -self._upper

    @classmethod
    def shared_by(cls, group: ActuatorNetwork) -> Hashable:
        return group.file

    def efforts(self, position: Tensor, velocity: Tensor, targets: Sequence[Tensor]) -> Tensor:
        """(N, k) from measured state (N, k) and position, velocity and effort targets (N, k) each."""
        inputs = torch.stack((targets[0] - position, velocity), 2).flatten(0, 1)
        with torch.no_grad():
            efforts, past = self._network.step(inputs, self.past)
        self.past.copy_(past)
        return torch.clamp(efforts.view(self._size) + targets[2], self._lower, self._upper)
