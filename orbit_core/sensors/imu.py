"""Inertial measurement units."""

from __future__ import annotations

from typing import Any

import torch
from torch import Tensor

from orbit_core.dynamics.indexing import take_rows, write_rows
from orbit_core.dynamics.transforms import quat_rotate_inverse
from orbit_core.scene import ImuSpec
from orbit_core.sensors.averaging import AveragingSensor
from orbit_core.sensors.context import SensorContext
from orbit_core.sensors.mount import Mount
from orbit_core.sensors.timed import Values


class ImuSensor(AveragingSensor):
    """Angular velocity and proper acceleration of a frame, in its own axes.

    The acceleration is the change of the frame origin's velocity over the sensor's period (without a rate: over the
    world's step), divided by it, less gravity: at rest it points up with 9.81 m/s^2. A state written between steps is
    no acceleration, if the world announces its steps. After a reset, until the environment has stepped, the velocity
    counts as constant. Noise goes on both values, in their own units.
    """

    noisy = ("angular_velocity", "linear_acceleration")
    scheduled = (*AveragingSensor.scheduled, "_before_known")

    def __init__(self, spec: ImuSpec, context: SensorContext) -> None:
        super().__init__(spec, context, (3,))
        self._mount = Mount(context.engine, context.layout, spec.entity, spec.frame, spec.name)
        self._context = context
        self._before = torch.zeros(self.num_envs, 3, device=self.device)
        """(N, 3) velocity at the end of the last chunk."""
        self._before_known = False

    @property
    def angular_velocity(self) -> Tensor:
        """(N, 3) rad/s."""
        return self._read("angular_velocity")

    @property
    def linear_acceleration(self) -> Tensor:
        """(N, 3) m/s^2."""
        return self._read("linear_acceleration")

    def begin_step(self) -> None:
        super().begin_step()
        self._before.copy_(self._mount.velocity()[:, :3])
        self._before_known = True

    def _forget(self, env_ids: Tensor | None) -> None:
        super()._forget(env_ids)
        if env_ids is None:
            self._before_known = False
        elif self._before_known:
            write_rows(self._before, self._mount.velocity(env_ids)[:, :3], env_ids)

    def save_state(self) -> dict[str, Any]:
        return super().save_state() | {"before": self._before.clone()}

    def load_state(self, state: dict[str, Any]) -> None:
        super().load_state(state)
        self._before.copy_(state["before"])

    def _integrate(self, steps: int) -> Tensor:
        velocity = self._mount.velocity()[:, :3]
        change = velocity - self._before if self._before_known else torch.zeros_like(velocity)
        self._before.copy_(velocity)
        self._before_known = True
        return change / self.physics_dt

    def _measure(self, env_ids: Tensor | None) -> Values:
        orientation = self._mount.pose(env_ids)[:, 3:]
        gravity = take_rows(self._context.gravity, env_ids)
        angular = self._mount.velocity(env_ids)[:, 3:]
        both = torch.stack((angular, self._mean(env_ids) - gravity), 1)
        both = quat_rotate_inverse(orientation[:, None], both)
        return {"angular_velocity": both[:, 0], "linear_acceleration": both[:, 1]}
