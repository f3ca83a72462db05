"""Truncated signed distance fields: surfaces estimated from depth images of many viewpoints, on a grid of voxels.

Curless and Levoy, A Volumetric Method for Building Complex Models from Range Images (SIGGRAPH 1996): a running mean of
each voxel's signed distance to the surface that was seen, weighted by the cosine between line of sight and normal.
Newcombe et al., KinectFusion (ISMAR 2011), section 3.3: each voxel looks up the pixel that it falls on; distances are
cut off at the truncation; voxels farther behind a surface than that are not seen; weights grow to a limit, so that
the field follows a scene that changes. Bylow et al., Real-Time Camera Tracking and 3D Reconstruction Using Signed
Distance Functions (RSS 2013), section III: the distance is that to the plane through the pixel's point, and not along
the line of sight, which overstates it where a surface is seen at a slant.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import torch
from torch import Tensor

from orbit_core.dynamics.indexing import write_rows
from orbit_core.dynamics.transforms import pose_inverse, transform_points
from orbit_core.interfaces import ConfigurationError, ShapeError
from orbit_core.scene.pose import Vector3
from orbit_core.sensors.camera import point_cloud, project

# Distance (m) for pixels that see nothing.
_FREE = 1e4


@dataclass(frozen=True)
class TsdfConfig:
    """Grid of a field, and its rate of adaptation.

    Args:
        lower: the corner of least coordinates of the first voxel, in metres in the environment's frame.
        voxel_size: of a voxel's edge in metres.
        shape: voxels along x, y and z.
        truncation: metres before and behind a surface in which distances are known; four voxels where None. At least
            two voxels, so that a surface has voxels on both of its sides.
        max_weight: limit of a voxel's weight. A smaller one makes new images replace old ones faster.

    Raises:
        ConfigurationError: a size that cannot be.
    """

    lower: Vector3
    voxel_size: float
    shape: tuple[int, int, int]
    truncation: float | None = None
    max_weight: float = 64.0

    def __post_init__(self) -> None:
        if not (self.voxel_size > 0.0 and math.isfinite(self.voxel_size)):
            raise ConfigurationError(f"the voxels of a distance field cannot be {self.voxel_size} m wide: give metres")
        if min(self.shape) < 2:
            raise ConfigurationError(f"a distance field needs two voxels or more along each axis, not {self.shape}")
        if self.band < 2.0 * self.voxel_size:
            raise ConfigurationError(
                f"a truncation of {self.band:g} m leaves surfaces without voxels on both sides: take at least two "
                f"voxels, {2.0 * self.voxel_size:g} m"
            )
        if self.max_weight < 1.0:
            raise ConfigurationError(f"max_weight of a distance field must be at least 1, not {self.max_weight:g}")

    @property
    def band(self) -> float:
        """Truncation in metres."""
        return 4.0 * self.voxel_size if self.truncation is None else self.truncation


@dataclass(frozen=True)
class DistanceSample:
    """Values of a field at points."""

    distances: Tensor
    """Distances (N, P) in metres to the nearest seen surface, positive in front of it and negative behind, at most the
    truncation either way. The truncation where not known."""
    gradients: Tensor
    """Gradients (N, P, 3) of the distance in the environment's axes: away from the surface. Zero where not known."""
    known: Tensor
    """True (N, P) where all eight voxels around the point have been seen."""


class TsdfVolume:
    """Truncated signed distances of N environments, positive in free space.

    Images are integrated and environments reset in place, and sizes depend on no values, so that both can be part of
    a captured step. The zero level is on the surface. Away from it distances are overstated, up to twice next to a ball
    that is seen from all around: to a line of sight that passes by, a voxel is free by the whole truncation.
    """

    def __init__(self, config: TsdfConfig, num_envs: int, device: torch.device) -> None:
        self.config = config
        self.distances = torch.full((num_envs, *config.shape), config.band, device=device)
        """Distances (N, X, Y, Z) in m at the voxels' centres, within the truncation; the truncation where not seen."""
        self.weights = torch.zeros(num_envs, *config.shape, device=device)
        """Weights (N, X, Y, Z): images that have seen each voxel, each by the cosine of its view, up to the limit."""
        grid = torch.meshgrid(*(torch.arange(n, device=device) + 0.5 for n in config.shape), indexing="ij")
        self._lower = torch.tensor(config.lower, dtype=torch.float32, device=device)
        self._centres = self._lower + config.voxel_size * torch.stack(grid, -1).flatten(0, 2)
        self._most = torch.tensor(config.shape, device=device) - 2
        corner = torch.arange(8, device=device)
        # Offsets of a cube's corners: the bits of 0 to 7.
        self._corners = torch.stack(((corner >> 2) & 1, (corner >> 1) & 1, corner & 1), -1)
        self._strides = torch.tensor((config.shape[1] * config.shape[2], config.shape[2], 1), device=device)

    @property
    def centres(self) -> Tensor:
        """Centres (X, Y, Z, 3) of the voxels, in metres in the environment's frame."""
        return self._centres.unflatten(0, self.config.shape)

    def reset(self, env_ids: Tensor | None = None) -> None:
        """Clear some environments, by index or by mask (N,) bool."""
        write_rows(self.distances, self.config.band, env_ids)
        write_rows(self.weights, 0.0, env_ids)

    def integrate(self, depth: Tensor, intrinsics: Tensor, pose: Tensor, seen: Tensor | None = None) -> None:
        """Add an image of every environment, or of those where ``seen``.

        Args:
            depth: (N, H, W, 1) metres along the optical axis. Infinite where the line of sight is free for all of its
                length; zero, negative or NaN where nothing is known.
            intrinsics: (3, 3) of the camera, in pixels.
            pose: (N, 7) of the camera in the environment's frame, -z forward and y up.
            seen: (N,) bool.

        Raises:
            ShapeError: depth or pose of another shape.
        """
        count = len(self.distances)
        if depth.dim() != 4 or depth.shape[::3] != (count, 1):
            raise ShapeError(f"depth pictures must have shape ({count}, H, W, 1), not {tuple(depth.shape)}")
        if pose.shape != (count, 7):
            raise ShapeError(f"the camera's pose must have shape ({count}, 7), not {tuple(pose.shape)}")
        distance, weight = self._look(depth, intrinsics, pose)
        known = weight > 0.0
        if seen is not None:
            known &= seen[:, None]
        held, old = self.distances.flatten(1), self.weights.flatten(1)  # views: writing to them changes the field
        new = old + weight
        mean = (old * held + weight * distance) / new
        held.copy_(torch.where(known, mean, held))
        old.copy_(torch.where(known, new.clamp_max(self.config.max_weight), old))

    def _look(self, depth: Tensor, intrinsics: Tensor, pose: Tensor) -> tuple[Tensor, Tensor]:
        """Compute distance and weight (N, V) of each voxel; the weight is zero where the image has no information."""
        height, width = depth.shape[1:3]
        local = transform_points(pose_inverse(pose)[:, None], self._centres)
        ahead = -local[..., 2]
        column, row = project(local, intrinsics).floor().unbind(-1)
        inside = (column >= 0) & (column < width) & (row >= 0) & (row < height) & (ahead > 0.0)
        # The nearest pixel, not an interpolation, which would draw surfaces between the edge of a thing and its
        # background.
        pixel = torch.where(inside, row * width + column, 0.0).to(torch.int64)
        facets = surface_facets(depth, intrinsics).flatten(1, 2)
        normal, offset, looked_at, facing = (
            facets.gather(1, pixel[..., None].expand(-1, -1, 6)).split((3, 1, 1, 1), -1)
        )  # fmt: skip
        distance = (normal * local).sum(-1) - offset[..., 0]
        useful = inside & (looked_at[..., 0] - ahead >= -self.config.band) & (facing[..., 0] > 0.0)  # NaN is neither
        return distance.clamp(-self.config.band, self.config.band), torch.where(useful, facing[..., 0], 0.0)

    def sample(self, points: Tensor) -> DistanceSample:
        """Interpolate distances and gradients linearly at points (N, P, 3) of the environment's frame.

        Raises:
            ShapeError: points of another shape.
        """
        count = len(self.distances)
        if points.dim() != 3 or points.shape[::2] != (count, 3):
            raise ShapeError(
                f"points in {count} environments must have shape ({count}, P, 3), not {tuple(points.shape)}"
            )
        # Values belong to the voxels' centres, half a voxel from their corners.
        place = (points - self._lower) / self.config.voxel_size - 0.5
        first = place.floor().clamp_min(0.0).minimum(self._most)
        share = place - first
        inside = ((share >= 0.0) & (share <= 1.0)).all(-1)
        voxels = ((first.to(torch.int64)[:, :, None] + self._corners) * self._strides).sum(-1)
        values, weights = (
            field.flatten(1).gather(1, voxels.flatten(1)).unflatten(1, voxels.shape[1:])
            for field in (self.distances, self.weights)
        )
        known = inside & (weights > 0.0).all(-1)
        distances, gradients = _trilinear(values.unflatten(-1, (2, 2, 2)), share)
        return DistanceSample(
            torch.where(known, distances, self.config.band),
            torch.where(known[..., None], gradients / self.config.voxel_size, 0.0),
            known,
        )


def surface_facets(depth: Tensor, intrinsics: Tensor) -> Tensor:
    """Compute normal towards the camera, offset, depth and cosine (N, H, W, 6) of the surface at each pixel.

    The plane through the pixel's point is ``normal . x = offset`` in the camera's frame, the normal from the points of
    the neighbouring pixels. The cosine is that between normal and line of sight; at the edge of an object, where
    neighbouring pixels show places far apart, it is almost zero. NaN where the pixel or a neighbour is unknown.
    """
    known = torch.where(depth > 0.0, depth, torch.nan).clamp_max(_FREE)
    # ``known - known`` is zero, or NaN where nothing is known: it spreads to the points.
    points = point_cloud(known.nan_to_num(0.0), intrinsics) + (known - known)
    right = torch.cat((points[:, :, 1:], points[:, :, -1:]), 2) - torch.cat((points[:, :, :1], points[:, :, :-1]), 2)
    down = torch.cat((points[:, 1:], points[:, -1:]), 1) - torch.cat((points[:, :1], points[:, :-1]), 1)
    normals = torch.nn.functional.normalize(torch.linalg.cross(down, right), dim=-1)
    offsets = (normals * points).sum(-1, keepdim=True)
    return torch.cat((normals, offsets, known, -offsets / points.norm(dim=-1, keepdim=True)), -1)


def _trilinear(values: Tensor, share: Tensor) -> tuple[Tensor, Tensor]:
    """Return value (N, P) and its derivative (N, P, 3) within cubes of corners (N, P, 2, 2, 2), at shares (N, P, 3)."""
    x, y, z = share.unbind(-1)
    along_x = torch.lerp(values[..., 0, :, :], values[..., 1, :, :], x[..., None, None])
    along_y = torch.lerp(along_x[..., 0, :], along_x[..., 1, :], y[..., None])
    step_x = values[..., 1, :, :] - values[..., 0, :, :]
    step_x = torch.lerp(step_x[..., 0, :], step_x[..., 1, :], y[..., None])
    step_y = along_x[..., 1, :] - along_x[..., 0, :]
    across = (torch.lerp(step[..., 0], step[..., 1], z) for step in (step_x, step_y))
    gradient = torch.stack((*across, along_y[..., 1] - along_y[..., 0]), -1)
    return torch.lerp(along_y[..., 0], along_y[..., 1], z), gradient
