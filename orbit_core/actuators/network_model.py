"""Actuator networks at run time: one network for some joints of all environments."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import torch
from torch import Tensor

from orbit_core.actuators.networks import check_rate, read_network
from orbit_core.dynamics.indexing import columns_of, write_rows
from orbit_core.interfaces import ConfigurationError, SceneLayout
from orbit_core.scene import JointType


class NetworkModel:
    """Efforts (N, k) of the joints that share an actuator network's file.

    Args:
        joints: indices (k,) in the scene.
        file: path of the network.
        layout: of the scene.
        num_envs: N.
        device: where tensors live.

    Raises:
        ConfigurationError: the file cannot be read; or the network is of another rate, or for joints of another unit.
    """

    def __init__(
        self, joints: Sequence[int], file: str, layout: SceneLayout, num_envs: int, device: torch.device
    ) -> None:
        self.joints = list(joints)
        self.columns = columns_of(self.joints, device)
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
        limits = torch.as_tensor(layout.joint_parameters.effort_limit[self.joints], dtype=torch.float32, device=device)
        self._lower, self._upper = -limits, limits

    def efforts(self, position: Tensor, velocity: Tensor, targets: Sequence[Tensor]) -> Tensor:
        """(N, k) from measured state (N, k) and position, velocity and effort targets (N, k) each."""
        inputs = torch.stack((targets[0] - position, velocity), 2).flatten(0, 1)
        with torch.no_grad():
            efforts, past = self._network.step(inputs, self.past)
        self.past.copy_(past)
        return torch.clamp(efforts.view(self._size) + targets[2], self._lower, self._upper)

    def reset(self, env_ids: Tensor | None) -> None:
        """Forget the past of some environments, by index or mask."""
        rows = self.past.unflatten(1, self._size).transpose(0, 1)
        write_rows(rows, 0.0, env_ids)
