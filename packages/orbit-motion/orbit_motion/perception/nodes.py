"""Perception as nodes of an agent: from a camera's images to clouds and distance fields."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from enum import Enum

import torch
from torch import Tensor

from orbit_core.dynamics.indexing import write_rows
from orbit_core.dynamics.random import RandomStreams
from orbit_core.dynamics.transforms import pose_inverse, pose_multiply, transform_points
from orbit_core.interfaces import ConfigurationError, Node, Port, ShapeError
from orbit_core.scene import CameraSpec
from orbit_core.scene.pose import Vector3
from orbit_core.sensors.camera import intrinsic_matrix, point_cloud, project

# Point clouds of a fixed number of points, cut to a workspace ---------------------------------------------------------


class Sampling(Enum):
    """Selection of points for the cloud, where there are more than requested."""

    STRIDED = "strided"
    """Evenly spaced in the order of the pixels, row by row: the same at each call."""
    RANDOM = "random"
    """Drawn without replacement, each as likely as another, from the environments' own random streams."""


@dataclass(frozen=True)
class PointCloudConfig:
    """Conversion of an image to a cloud.

    Args:
        points: how many points the cloud has (P).
        sampling: which of more points are taken.
        lower: the workspace's corner of least coordinates in metres, in the frame of the points; none on None.
        upper: the workspace's other corner.

    Raises:
        ConfigurationError: there are no points, or the workspace is empty.
    """

    points: int
    sampling: Sampling = Sampling.STRIDED
    lower: Vector3 | None = None
    upper: Vector3 | None = None

    def __post_init__(self) -> None:
        if self.points < 1:
            raise ConfigurationError(f"a point cloud of {self.points} points cannot be: ask for at least one")
        if (self.lower is None) != (self.upper is None):
            raise ConfigurationError("the workspace of a point cloud needs both its lower and its upper corner")
        if self.lower and self.upper and any(a >= b for a, b in zip(self.lower, self.upper, strict=True)):
            raise ConfigurationError(
                f"the workspace from {self.lower} to {self.upper} is empty: every coordinate of the lower corner must "
                "be less than that of the upper one"
            )


@dataclass(frozen=True)
class PointCloud:
    """P points of each of N environments; a pixel is in it at most once."""

    points: Tensor
    """Positions (N, P, 3) in metres; zero where not valid."""
    colors: Tensor | None
    """Colours (N, P, 3) from 0 to 1; zero where not valid. None where the images had no colour."""
    valid: Tensor
    """Validity (N, P) bool: the first ones hold points, the rest, where fewer were seen than requested, none."""


def sample_point_cloud(
    points: Tensor, config: PointCloudConfig, rgb: Tensor | None = None, random: RandomStreams | None = None
) -> PointCloud:
    """Sample clouds of the points (N, H, W, 3) of pixels, such as those of :func:`orbit_core.sensors.point_cloud`.

    Points that are not finite show nothing, and are left out. Sizes depend on no values and nothing waits for the
    device, so this may stand in a recorded step.

    Args:
        points: in the frame that the cloud is wanted in.
        config: how many points to take, and where.
        rgb: (N, H, W, 3) uint8, of the same pixels.
        random: streams of the N environments, for random sampling: each takes H * W draws.

    Raises:
        ConfigurationError: random sampling without streams.
        ShapeError: points or colours of another shape.
    """
    if points.dim() != 4 or points.shape[-1] != 3:
        raise ShapeError(f"the points of pixels must have shape (N, H, W, 3), not {tuple(points.shape)}")
    if rgb is not None and rgb.shape != points.shape:
        raise ShapeError(f"the colours of pixels must have shape {tuple(points.shape)}, not {tuple(rgb.shape)}")
    points = points.flatten(1, 2)
    there = _inside(points, config)
    pixels, valid = _random(there, config.points, random) if config.sampling is Sampling.RANDOM else _strided(
        there, config.points
    )  # fmt: skip
    chosen = pixels[..., None].expand(-1, -1, 3)
    found = torch.where(valid[..., None], points.gather(1, chosen), 0.0)
    if rgb is None:
        return PointCloud(found, None, valid)
    colors = rgb.flatten(1, 2).gather(1, chosen).to(torch.float32) / 255.0
    return PointCloud(found, torch.where(valid[..., None], colors, 0.0), valid)


def _inside(points: Tensor, config: PointCloudConfig) -> Tensor:
    """Return True (N, H W) for points in the workspace."""
    there = points.isfinite().all(-1)
    if config.lower is None or config.upper is None:
        return there
    for axis, (low, high) in enumerate(zip(config.lower, config.upper, strict=True)):
        there &= (points[..., axis] >= low) & (points[..., axis] <= high)
    return there


def _strided(there: Tensor, count: int) -> tuple[Tensor, Tensor]:
    """Return evenly spaced pixels (N, count) of the valid ones, and True where there were enough."""
    place = torch.arange(count, device=there.device)
    # Ranks by cumulative sum: the k-th valid pixel is found without a loop or a wait for the device.
    ranks = there.cumsum(1)
    total = ranks[:, -1:]
    wanted = torch.where(total > count, place * total // count, place)
    pixels = torch.searchsorted(ranks, wanted + 1)
    return pixels.clamp_max(there.shape[1] - 1), place < total


def _random(there: Tensor, count: int, random: RandomStreams | None) -> tuple[Tensor, Tensor]:
    """Draw pixels (N, count) from the valid ones; return True where there were enough."""
    if random is None:
        raise ConfigurationError("random sampling of a point cloud needs the environments' random streams")
    # The largest of random keys are a draw without replacement.
    keys = torch.where(there, random.uniform((there.shape[1],)), -1.0)
    most = min(count, there.shape[1])
    keys, pixels = keys.topk(most, dim=1)
    pixels, keys = (torch.nn.functional.pad(values, (0, count - most), value=-1) for values in (pixels, keys))
    return pixels.clamp_min(0), keys >= 0.0


# Truncated signed distance fields: surfaces estimated from depth images of many viewpoints, on a grid of voxels.
# Curless and Levoy, A Volumetric Method for Building Complex Models from Range Images (SIGGRAPH 1996): a running mean
# of each voxel's signed distance to the surface that was seen, weighted by the cosine between line of sight and normal.
# Newcombe et al., KinectFusion (ISMAR 2011), section 3.3: each voxel looks up the pixel that it falls on; distances are
# cut off at the truncation; voxels farther behind a surface than that are not seen; weights grow to a limit, so that
# the field follows a scene that changes. Bylow et al., Real-Time Camera Tracking and 3D Reconstruction Using Signed
# Distance Functions (RSS 2013), section III: the distance is that to the plane through the pixel's point, and not along
# the line of sight, which overstates it where a surface is seen at a slant.

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
        """Grid and truncation."""
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


class CloudFrame(Enum):
    """Frame of a cloud's points."""

    CAMERA = "camera"
    """Camera axes: -z forward, y up."""
    ENVIRONMENT = "environment"
    """The environment's own frame."""
    BODY = "body"
    """Frame of a body, such as a robot's base, whose pose is an input of the node."""


class PointCloudNode(Node):
    """Node that converts colour and depth to a cloud of a fixed number of points.

    Inputs: ``depth`` (H, W, 1) in metres, infinite where nothing is hit; ``rgb`` (H, W, 3) uint8; ``pose`` (7,) of the
    camera in the environment's frame, unless points are wanted in the camera's; ``body`` (7,), where they are wanted in
    that of a body. Outputs: ``points`` (P, 3) in metres, ``colors`` (P, 3) from 0 to 1, ``valid`` (P,) bool.

    Args:
        name: of the node.
        camera: whose pictures come in.
        config: number and selection of points, and the workspace in the chosen frame.
        device: device of the pictures.
        frame: frame of the points.
        random: streams of the environments, for random sampling.
        rate: rate in Hz; None for the agent's.
    """

    def __init__(
        self,
        name: str,
        camera: CameraSpec,
        config: PointCloudConfig,
        device: torch.device,
        frame: CloudFrame = CloudFrame.ENVIRONMENT,
        random: RandomStreams | None = None,
        rate: float | None = None,
    ) -> None:
        picture = (camera.height, camera.width)
        poses = {CloudFrame.CAMERA: (), CloudFrame.ENVIRONMENT: ("pose",), CloudFrame.BODY: ("pose", "body")}[frame]
        self.name = name
        self.inputs = (Port("depth", (*picture, 1)), Port("rgb", (*picture, 3)), *(Port(pose, (7,)) for pose in poses))
        points = (config.points, 3)
        self.outputs = (Port("points", points), Port("colors", points), Port("valid", points[:1]))
        self.rate = rate
        self._config = config
        self._frame = frame
        self._random = random
        self._intrinsics = intrinsic_matrix(camera).to(device)

    def compute(self, inputs: Mapping[str, Tensor]) -> Mapping[str, Tensor]:
        points = point_cloud(inputs["depth"], self._intrinsics, self._pose(inputs))
        cloud = sample_point_cloud(points, self._config, inputs["rgb"], self._random)
        assert cloud.colors is not None  # colours were given
        return {"points": cloud.points, "colors": cloud.colors, "valid": cloud.valid}

    def _pose(self, inputs: Mapping[str, Tensor]) -> Tensor | None:
        """Return the pose of the camera in the frame of the points."""
        if self._frame is CloudFrame.CAMERA:
            return None
        if self._frame is CloudFrame.ENVIRONMENT:
            return inputs["pose"]
        return pose_multiply(pose_inverse(inputs["body"]), inputs["pose"])


class TsdfNode(Node):
    """Node that integrates a camera's depth images into a truncated signed distance field.

    Inputs: ``depth`` (H, W, 1) in metres; ``pose`` (7,) of the camera in the environment's frame. Outputs:
    ``distances`` and ``weights`` (X, Y, Z), the field's own tensors, which the next update overwrites.

    Args:
        name: of the node.
        camera: whose pictures come in.
        config: the grid.
        num_envs: number of environments.
        device: where the pictures are.
        rate: rate in Hz, best that of the camera, because an image that is read twice counts twice; None for the
            agent's.
    """

    def __init__(
        self,
        name: str,
        camera: CameraSpec,
        config: TsdfConfig,
        num_envs: int,
        device: torch.device,
        rate: float | None = None,
    ) -> None:
        self.name = name
        self.inputs = (Port("depth", (camera.height, camera.width, 1)), Port("pose", (7,)))
        self.outputs = (Port("distances", config.shape), Port("weights", config.shape))
        self.rate = rate
        self.volume = TsdfVolume(config, num_envs, device)
        """Field that images are integrated into."""
        self._intrinsics = intrinsic_matrix(camera).to(device)

    def compute(self, inputs: Mapping[str, Tensor]) -> Mapping[str, Tensor]:
        self.volume.integrate(inputs["depth"], self._intrinsics, inputs["pose"])
        # The field itself, not a copy, because it is large.
        return self.memory()

    def reset(self, env_ids: Tensor | None = None) -> None:
        self.volume.reset(env_ids)

    def memory(self) -> Mapping[str, Tensor]:
        return {"distances": self.volume.distances, "weights": self.volume.weights}
