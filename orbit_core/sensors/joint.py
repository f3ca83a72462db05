"""Joint encoders."""

from __future__ import annotations

import torch
from torch import Tensor

from orbit_core.dynamics.indexing import take_rows
from orbit_core.interfaces import match_names
from orbit_core.scene import JointSensorSpec
from orbit_core.sensors.context import SensorContext
from orbit_core.sensors.mount import find_entity
from orbit_core.sensors.timed import TimedSensor, Values


class JointSensor(TimedSensor):
    """Positions and velocities of an entity's joints. Noise goes on both, in their own units."""

    noisy = ("positions", "velocities")

    def __init__(self, spec: JointSensorSpec, context: SensorContext) -> None:
        super().__init__(spec, context)
        entity = find_entity(context.layout, spec.entity, spec.name)
        names = entity.spec.articulation.joint_names
        joints = match_names(spec.joints, names, "joint", f"sensor '{spec.name}'")
        self.joint_names = tuple(names[joint] for joint in joints)
        """Names of the joints of the columns, in the articulation's order."""
        self._joints = torch.tensor(joints, dtype=torch.int64, device=self.device) + entity.joints.start

    @property
    def positions(self) -> Tensor:
        """(N, joints) rad or m."""
        return self._read("positions")

    @property
    def velocities(self) -> Tensor:
        """(N, joints) rad/s or m/s."""
        return self._read("velocities")

    def _measure(self, env_ids: Tensor | None) -> Values:
        positions = self.engine.joint_positions.index_select(1, self._joints)
        velocities = self.engine.joint_velocities.index_select(1, self._joints)
        return {"positions": take_rows(positions, env_ids), "velocities": take_rows(velocities, env_ids)}
