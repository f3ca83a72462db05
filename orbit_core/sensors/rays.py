"""LiDARs and height scans: ray casters, and patterns of rays for them."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor

from orbit_core.dynamics.transforms import pose_multiply, quat_rotate, quat_yaw, transform_points
from orbit_core.interfaces import ConfigurationError
from orbit_core.scene import RayCasterSpec
from orbit_core.scene.pose import Vector3
from orbit_core.sensors.proprioception import Mount, pose_tensor
from orbit_core.sensors.timed import SensorContext, TimedSensor, Values


def lidar_pattern(
    channels: int,
    vertical_fov: tuple[float, float],
    horizontal_fov: tuple[float, float] = (-np.pi, np.pi),
    horizontal_resolution: float = np.pi / 180,
) -> tuple[Vector3, ...]:
    """Return unit directions (channels x columns) of a scanning LiDAR that spins about z, x forward.

    Args:
        channels: how many rays stand above each other.
        vertical_fov: lowest and highest elevation in radians; both ends get a ray.
        horizontal_fov: first and last azimuth in radians. A full turn does not repeat its first column.
        horizontal_resolution: greatest angle between columns, in radians.

    Returns:
        Channel after channel from the lowest, each in order of azimuth.
    """
    if channels < 1 or horizontal_resolution <= 0.0:
        raise ConfigurationError("a LiDAR pattern needs at least one channel and a positive horizontal resolution")
    elevations = np.linspace(*vertical_fov, channels) if channels > 1 else np.array([sum(vertical_fov) / 2])
    span = horizontal_fov[1] - horizontal_fov[0]
    # The first and the last column of a full turn would be the same ray.
    full_turn = span >= 2 * np.pi - 1e-9
    intervals = max(int(np.ceil(span / horizontal_resolution - 1e-9)), 1)
    columns = intervals if full_turn else intervals + 1
    azimuths = np.linspace(*horizontal_fov, columns, endpoint=not full_turn)
    elevation, azimuth = (grid.ravel() for grid in np.meshgrid(elevations, azimuths, indexing="ij"))
    level = np.cos(elevation)
    return _vectors(np.stack((level * np.cos(azimuth), level * np.sin(azimuth), np.sin(elevation)), -1))


def grid_pattern(
    size: tuple[float, float], resolution: float, direction: Vector3 = (0.0, 0.0, -1.0)
) -> tuple[tuple[Vector3, ...], tuple[Vector3, ...]]:
    """Return origins and directions of parallel rays from a centred grid in the sensor's xy plane, as height scans use.

    Args:
        size: full extent (x, y) in metres; both ends get a ray, where the resolution divides it.
        resolution: distance between neighbouring rays in metres.
        direction: of all rays, in the sensor frame.

    Returns:
        Row after row along x, from the lowest y.
    """
    if resolution <= 0.0:
        raise ConfigurationError(f"the resolution of a grid pattern must be positive, not {resolution:g}")
    x, y = (_centred(extent, resolution) for extent in size)
    grid_y, grid_x = (grid.ravel() for grid in np.meshgrid(y, x, indexing="ij"))
    origins = _vectors(np.stack((grid_x, grid_y, np.zeros_like(grid_x)), -1))
    return origins, (direction,) * len(origins)


def _centred(extent: float, resolution: float) -> npt.NDArray[np.floating]:
    intervals = int(np.floor(extent / resolution + 1e-9))
    return (np.arange(intervals + 1) - intervals / 2) * resolution


def _vectors(rows: npt.NDArray[np.floating]) -> tuple[Vector3, ...]:
    return tuple((float(x), float(y), float(z)) for x, y, z in rows)


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
        # A sensor inside of a robot's shell would otherwise see nothing but the shell.
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
    # Engines divide by the length of a direction.
    lengths = directions.norm(dim=-1, keepdim=True)
    if not len(directions) or bool((lengths < 1e-9).any()):
        raise ConfigurationError(f"sensor '{spec.name}' needs at least one ray direction, each of non-zero length")
    return directions / lengths
