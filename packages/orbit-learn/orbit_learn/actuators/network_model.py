"""Actuator networks in simulation: one network for some joints of all environments."""

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
        context: joints whose groups are :class:`~orbit_core.scene.ActuatorNetwork` of the same file.

    Raises:
        ConfigurationError: the file cannot be read, or the network has another rate or unit.
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
        """Past (depth, N k, ...) of the network."""
        # A view of the same memory with environments first, so that resets clear it by environment.
        self.memory["past"] = self.past.unflatten(1, self._size).transpose(0, 1)
        self._upper = context.effort_limits
        self._lower = -self._upper

    @classmethod
    def shared_by(cls, group: ActuatorNetwork) -> Hashable:
        return group.file

    def efforts(self, position: Tensor, velocity: Tensor, targets: Sequence[Tensor]) -> Tensor:
        """Compute efforts (N, k) from the measured state (N, k) and targets (N, k) of position, velocity and effort."""
        inputs = torch.stack((targets[0] - position, velocity), 2).flatten(0, 1)
        with torch.no_grad():
            efforts, past = self._network.step(inputs, self.past)
        self.past.copy_(past)  # in place: a captured step keeps the tensor's address
        return torch.clamp(efforts.view(self._size) + targets[2], self._lower, self._upper)
