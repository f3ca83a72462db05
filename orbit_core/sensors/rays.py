"""LiDARs and height scans."""

from __future__ import annotations

import torch
from torch import Tensor

from orbit_core.dynamics.transforms import pose_multiply, quat_rotate, quat_yaw, transform_points
from orbit_core.interfaces import ConfigurationError
from orbit_core.scene import RayCasterSpec
from orbit_core.sensors.context import SensorContext
from orbit_core.sensors.mount import Mount, pose_tensor
from orbit_core.sensors.timed import TimedSensor, Values


class RayCaster(TimedSensor):
    """Distances along a pattern of rays to what the engine collides with.

    Rays pass through the entity that carries the sensor. A miss has infinite distance and point, and a zero normal.
    Noise, in metres, goes on the distances.
    """

    noisy = ("distances",)
    costly = True

    def __init__(self, spec: RayCasterSpec, context: SensorContext) -> None:
        """Resolve the frame and the pattern.

        Raises:
            ConfigurationError: a direction has no length, or origins and directions differ in number.
        """
        super().__init__(spec, context)
        self._ray_spec = spec
        place = (context.engine, context.layout, spec.entity, spec.frame, spec.name)
        # A level pattern keeps its own pose relative to the heading, not to the tilted frame.
        self._mount = Mount(*place) if spec.yaw_only else Mount(*place, spec.pose)
        self._offset = pose_tensor(spec.pose, self.device)
        self._directions = _unit_directions(spec).to(self.device)
        if spec.origins and len(spec.origins) != len(spec.directions):
            raise ConfigurationError(
                f"sensor '{spec.name}' has {len(spec.origins)} ray origins for {len(spec.directions)} directions: "
                "give one each, or no origins"
            )
        self._origins = torch.tensor(spec.origins or ((0.0, 0.0, 0.0),), dtype=torch.float32, device=self.device)

    @property
    def distances(self) -> Tensor:
        """(N, R) metres from each ray's origin."""
        return self._read("distances")

    @property
    def points(self) -> Tensor:
        """(N, R, 3) where the rays ended, in the environment's frame."""
        distances = self.distances[..., None]
        points = self._read("origins") + torch.where(distances.isinf(), 0.0, distances) * self._read("directions")
        return torch.where(distances.isinf(), distances, points)

    @property
    def normals(self) -> Tensor:
        """(N, R, 3) unit normals of the surfaces, in world axes."""
        return self._read("normals")

    @property
    def links(self) -> Tensor:
        """(N, R) int64 link index in the scene's layout, TERRAIN or BACKGROUND."""
        return self._read("links")

    @property
    def pose(self) -> Tensor:
        """(N, 7) of the pattern, in the environment's frame, when it measured."""
        return self._read("pose")

    def _measure(self, env_ids: Tensor | None) -> Values:
        pose = self._pattern_pose(env_ids)
        rays = self._directions.shape[0]
        origins = transform_points(pose[:, None], self._origins).expand(-1, rays, -1)
        directions = quat_rotate(pose[:, None, 3:], self._directions)
        reach = self._ray_spec.max_distance
        own = self._mount.entity.links
        parts = origins.contiguous(), directions.contiguous(), reach, range(own.start, own.stop), env_ids
        hits = self.engine.cast_rays_past(*parts)
        return {
            "distances": hits.distances, "normals": hits.normals, "links": hits.links,
            "origins": origins, "directions": directions, "pose": pose,
        }  # fmt: skip

    def _pattern_pose(self, env_ids: Tensor | None) -> Tensor:
        pose = self._mount.pose(env_ids)
        if not self._ray_spec.yaw_only:
            return pose
        return pose_multiply(torch.cat((pose[:, :3], quat_yaw(pose[:, 3:])), -1), self._offset)


def _unit_directions(spec: RayCasterSpec) -> Tensor:
    directions = torch.tensor(spec.directions, dtype=torch.float32).view(-1, 3)
    lengths = directions.norm(dim=-1, keepdim=True)
    if not len(directions) or bool((lengths < 1e-9).any()):
        raise ConfigurationError(f"sensor '{spec.name}' needs at least one ray direction, each of non-zero length")
    return directions / lengths
