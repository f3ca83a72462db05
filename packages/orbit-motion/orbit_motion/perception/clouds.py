"""Point clouds of a fixed number of points, cut to a workspace."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum

import torch
from torch import Tensor

from orbit_core.dynamics.random import RandomStreams
from orbit_core.interfaces import ConfigurationError, ShapeError
from orbit_core.scene.pose import Vector3


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
