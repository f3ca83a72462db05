"""The pose and velocity of a frame, as a tracking system would give them."""

from __future__ import annotations

import torch
from torch import Tensor

from orbit_core.dynamics.transforms import (
    pose_inverse,
    pose_multiply,
    quat_from_rotation_vector,
    quat_multiply,
    quat_rotate_inverse,
)
from orbit_core.scene import FrameSensorSpec
from orbit_core.sensors.context import SensorContext
from orbit_core.sensors.mount import Mount
from orbit_core.sensors.timed import TimedSensor, Values


class FrameSensor(TimedSensor):
    """Pose and velocity of a link or named frame, in the environment's frame or seen from another frame.

    Seen from a frame that moves, the velocity is that of an observer who moves with it, in its axes. Noise goes on the
    position (m), the orientation (a rotation vector in rad) and the velocity.
    """

    noisy = ("velocity",)

    def __init__(self, spec: FrameSensorSpec, context: SensorContext) -> None:
        super().__init__(spec, context)
        place = (context.engine, context.layout, spec.entity)
        self._frame = Mount(*place, spec.frame, spec.name)
        self._reference = None if spec.relative_to is None else Mount(*place, spec.relative_to, spec.name)

    @property
    def pose(self) -> Tensor:
        """(N, 7)"""
        return self._read("pose")

    @property
    def velocity(self) -> Tensor:
        """(N, 6) linear, then angular."""
        return self._read("velocity")

    def _measure(self, env_ids: Tensor | None) -> Values:
        pose, velocity = self._frame.pose(env_ids), self._frame.velocity(env_ids)
        if self._reference is None:
            return {"pose": pose, "velocity": velocity}
        base, base_velocity = self._reference.pose(env_ids), self._reference.velocity(env_ids)
        relative = velocity - base_velocity
        carried = torch.linalg.cross(base_velocity[:, 3:], pose[:, :3] - base[:, :3])
        seen = torch.stack((relative[:, :3] - carried, relative[:, 3:]), 1)
        seen = quat_rotate_inverse(base[:, None, 3:], seen).flatten(1)
        return {"pose": pose_multiply(pose_inverse(base), pose), "velocity": seen}

    def _corrupt(self, values: Values, env_ids: Tensor | None) -> None:
        super()._corrupt(values, env_ids)
        pose, noise = values["pose"], self._noise("pose", (6,), env_ids)
        orientation = quat_multiply(quat_from_rotation_vector(noise[:, 3:]), pose[:, 3:])
        orientation = torch.where(orientation[:, :1] < 0, -orientation, orientation)
        values["pose"] = torch.cat((pose[:, :3] + noise[:, :3], orientation), -1)
