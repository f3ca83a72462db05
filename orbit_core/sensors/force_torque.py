"""Force-torque sensors in joints."""

from __future__ import annotations

from torch import Tensor

from orbit_core.dynamics.indexing import take_rows
from orbit_core.interfaces import find_name
from orbit_core.scene import ForceTorqueSpec
from orbit_core.sensors.context import SensorContext
from orbit_core.sensors.timed import TimedSensor, Values


class ForceTorqueSensor(TimedSensor):
    """The wrench that a link receives from its parent, about the link frame's origin, in the link's axes.

    Of the last physics step before the measurement. Noise goes on force and torque, in their own units.
    """

    noisy = ("wrench",)

    def __init__(self, spec: ForceTorqueSpec, context: SensorContext) -> None:
        super().__init__(spec, context)
        entity = context.layout.entity(spec.entity)
        names = entity.spec.articulation.link_names
        link = entity.links.start + find_name(spec.link, names, "link", f"sensor '{spec.name}'")
        self._column = context.layout.wrench_links.index(link)

    @property
    def wrench(self) -> Tensor:
        """(N, 6) force (N), then torque (N m)."""
        return self._read("wrench")

    @property
    def force(self) -> Tensor:
        """(N, 3) newtons."""
        return self.wrench[:, :3]

    @property
    def torque(self) -> Tensor:
        """(N, 3) newton metres."""
        return self.wrench[:, 3:]

    def _measure(self, env_ids: Tensor | None) -> Values:
        return {"wrench": take_rows(self.engine.joint_wrenches[:, self._column].clone(), env_ids)}
