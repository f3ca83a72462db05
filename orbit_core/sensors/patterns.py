"""Patterns of rays for LiDARs and height scans, as plain data for a :class:`~orbit_core.scene.RayCasterSpec`."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from orbit_core.interfaces import ConfigurationError
from orbit_core.scene.pose import Vector3


def lidar_pattern(
    channels: int,
    vertical_fov: tuple[float, float],
    horizontal_fov: tuple[float, float] = (-np.pi, np.pi),
    horizontal_resolution: float = np.pi / 180,
) -> tuple[Vector3, ...]:
    """Unit directions (channels x columns) of a scanning LiDAR that spins about z, x forward.

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
    """Origins and directions of parallel rays from a centred grid in the sensor's xy plane, as height scans use.

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
