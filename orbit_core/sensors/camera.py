"""Cameras: colour, depth, positions, normals, segmentation, and points from depth."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, fields, replace

import torch
from torch import Tensor

from orbit_core.dynamics.indexing import take_rows
from orbit_core.dynamics.transforms import pose_multiply, transform_points
from orbit_core.interfaces import BACKGROUND, TERRAIN, ConfigurationError, Image, SceneLayout
from orbit_core.plugin_kit.rows import write_rows
from orbit_core.scene import CameraSpec, Channel
from orbit_core.sensors.proprioception import Mount, pose_tensor
from orbit_core.sensors.timed import SensorContext, TimedSensor, Values


def intrinsic_matrix(camera: CameraSpec) -> Tensor:
    """Return (3, 3) pinhole matrix in pixels: u to the right and v down from the image's top left corner.

    Pixel (row, column) has its centre at ``(u, v) = (column + 0.5, row + 0.5)``; pixels are square.
    """
    return _pinholes(camera, torch.tensor(camera.vertical_fov))


def _pinholes(camera: CameraSpec, fov: Tensor) -> Tensor:
    """Return pinhole matrices (..., 3, 3) of vertical fields of view (...) in radians."""
    # Square pixels: one focal length, set by the vertical field of view.
    focal = 0.5 * camera.height / torch.tan(0.5 * fov)
    zero, one = torch.zeros_like(focal), torch.ones_like(focal)
    rows = (focal, zero, one * (camera.width / 2), zero, focal, one * (camera.height / 2), zero, zero, one)
    return torch.stack(rows, dim=-1).unflatten(-1, (3, 3))


def point_cloud(depth: Tensor, intrinsics: Tensor, pose: Tensor | None = None) -> Tensor:
    """Return points (n, H, W, 3) of depth images (n, H, W, 1), infinite where nothing was seen.

    In the camera's frame (-z forward, y up), or in the environment's where the camera's ``pose`` (n, 7) is given.

    Args:
        depth: (n, H, W, 1) m along the optical axis.
        intrinsics: (3, 3) of the camera, in pixels, or (n, 3, 3) where pictures differ in it.
        pose: (n, 7) of the camera; None gives points in its own frame.
    """
    height, width = depth.shape[1:3]
    column = torch.arange(width, device=depth.device) + 0.5
    row = torch.arange(height, device=depth.device) + 0.5
    across, up, middle, level = (intrinsics[..., a, b, None, None] for a, b in ((0, 0), (1, 1), (0, 2), (1, 2)))
    shape = (*intrinsics.shape[:-2], height, width)
    x, y = ((column - middle) / across).expand(shape), ((row[:, None] - level) / up).expand(shape)
    seen = depth.isfinite()
    points = torch.stack((x, -y, -torch.ones_like(x)), -1) * torch.where(seen, depth, 0.0)
    if pose is not None:
        points = transform_points(pose[:, None, None], points)
    return torch.where(seen, points, torch.inf)


def project(points: Tensor, intrinsics: Tensor) -> Tensor:
    """Return pixel coordinates (..., 2), u then v, of points (..., 3) in the camera's frame (-z forward, y up)."""
    depth = -points[..., 2]
    u = intrinsics[0, 0] * points[..., 0] / depth + intrinsics[0, 2]
    v = -intrinsics[1, 1] * points[..., 1] / depth + intrinsics[1, 2]
    return torch.stack((u, v), -1)


@dataclass(frozen=True, eq=False)
class Zoom:
    """Fields of view of environments, cut out of pictures of the widest one."""

    camera: CameraSpec
    """The camera that draws, with the widest field of view."""
    fov: Tensor
    """(N,) radians."""

    @property
    def widest(self) -> float:
        """Radians."""
        return self.camera.vertical_fov

    def cut(self, image: Image, fov: Tensor) -> Image:
        """Return the pictures (n, H, W, channels) that cameras of these fields of view (n,) would take."""
        share = torch.tan(0.5 * fov) / math.tan(0.5 * self.widest)
        return Image(
            **{each.name: self._cut(getattr(image, each.name), share, each.name == "rgb") for each in fields(image)}
        )

    def _cut(self, pictures: Tensor | None, share: Tensor, blend: bool) -> Tensor | None:
        if pictures is None:
            return None
        count, height, width = pictures.shape[:3]
        # Pixels' centres, in [-1, 1] over the picture.
        x = (2.0 * torch.arange(width, device=share.device) + 1.0) / width - 1.0
        y = (2.0 * torch.arange(height, device=share.device) + 1.0) / height - 1.0
        grid = share[:, None, None, None] * torch.stack(torch.meshgrid(x, y, indexing="xy"), dim=-1)
        if blend:
            sampled = torch.nn.functional.grid_sample(
                pictures.permute(0, 3, 1, 2).float(), grid, padding_mode="border", align_corners=False
            )
            return (sampled.permute(0, 2, 3, 1) + 0.5).to(pictures.dtype)
        # Indices, and depths of which some are infinite, must not be blended.
        column = ((grid[..., 0] + 1.0) * (0.5 * width)).long().clamp(0, width - 1)
        row = ((grid[..., 1] + 1.0) * (0.5 * height)).long().clamp(0, height - 1)
        return pictures[torch.arange(count, device=share.device)[:, None, None], row, column]


class CameraSensor(TimedSensor):
    """A pinhole camera, fixed in the environment or carried by a frame. It does not see markers.

    Noise is that of depth, in metres; positions follow from the noisy depth, and the other channels have none.
    """

    noisy = (Channel.DEPTH.value,)
    costly = True

    def __init__(self, spec: CameraSpec, context: SensorContext) -> None:
        """Resolve the frame.

        Raises:
            ConfigurationError: an entity without a frame or a frame without an entity, or noise without depth.
        """
        super().__init__(spec, context)
        # No renderer draws positions: they follow from depth, noise included.
        sources = (Channel.DEPTH if channel is Channel.POSITION else channel for channel in spec.channels)
        self._drawn = tuple(dict.fromkeys(sources))
        if (spec.entity is None) != (spec.frame is None):
            raise ConfigurationError(f"camera '{spec.name}' needs both an entity and a frame to sit on, or neither")
        if (spec.noise.std or spec.noise.bias_std) and Channel.DEPTH not in self._drawn:
            raise ConfigurationError(f"camera '{spec.name}' has noise, which is that of depth, but no depth channel")
        self._camera = spec
        self.layout = context.layout
        """Layout of the scene that the camera sees."""
        self._renderer = context.renderer
        self._mount: Mount | None = None
        if spec.entity is not None and spec.frame is not None:
            place = (context.engine, context.layout, spec.entity, spec.frame, spec.name)
            self._mount = Mount(*place, spec.pose)
        self._fixed_pose = pose_tensor(spec.pose, self.device).repeat(self.num_envs, 1)
        self._tables = {
            Channel.INSTANCE: _instance_table(context.layout).to(self.device),
            Channel.SEMANTIC: _semantic_table(context.layout).to(self.device),
        }
        self.semantic_labels = context.layout.semantic_labels
        """What the numbers of the semantic channel mean."""
        self.intrinsics = intrinsic_matrix(spec).to(self.device)
        """(3, 3) in pixels; (N, 3, 3) once environments differ in it."""
        # Of environments that differ from the specification; None costs nothing.
        self._displaced: Tensor | None = None
        self._zoom: Zoom | None = None

    def displace(self, offset: Tensor, env_ids: Tensor | None = None) -> None:
        """Place the camera of some environments away from where it was specified, from its next picture on.

        Args:
            offset: (n, 7) pose in the specified camera's own frame (-z forward, y up).
            env_ids: environments; all if None.
        """
        if self._displaced is None:
            still = torch.tensor((0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0), device=self.device)
            self._displaced = still.repeat(self.num_envs, 1)
        write_rows(self._displaced, offset, env_ids)

    def set_vertical_fov(self, fov: Tensor, widest: float, env_ids: Tensor | None = None) -> None:
        """Give the camera of some environments another field of view, from its next picture on.

        Pictures are drawn with the widest one and cut out of it, so that any renderer can: they are coarser by the
        ratio of the two tangents.

        Args:
            fov: (n,) radians, at most ``widest``.
            widest: radians, of all environments and from the first call on.
            env_ids: environments; all if None.
        """
        if self._zoom is None or self._zoom.widest < widest:
            before = None if self._zoom is None else self._zoom.fov
            own = torch.full((self.num_envs,), self._camera.vertical_fov, device=self.device)
            widest = max(widest, self._camera.vertical_fov)
            self._zoom = Zoom(replace(self._camera, vertical_fov=widest), own if before is None else before)
        write_rows(self._zoom.fov, fov, env_ids)
        self.intrinsics = _pinholes(self._camera, self._zoom.fov)

    @property
    def images(self) -> Mapping[Channel, Tensor]:
        """Images (N, H, W, channels) of each channel that the camera was specified with."""
        return {channel: self.image(channel) for channel in self._camera.channels}

    def image(self, channel: Channel) -> Tensor:
        """Return the picture (N, H, W, channels) of a channel.

        Raises:
            ConfigurationError: the camera was specified without that channel.
        """
        if channel not in self._camera.channels:
            raise self._lacks(channel)
        return self.point_cloud() if channel is Channel.POSITION else self._read(channel.value)

    @property
    def pose(self) -> Tensor:
        """Pose (N, 7), in the environment's frame, when the pictures were taken."""
        return self._read("pose")

    @property
    def link_poses(self) -> Tensor:
        """Poses (N, L, 7) of every link of the scene in the environment's frame, when the pictures were taken."""
        return self._read("link_poses")

    def point_cloud(self) -> Tensor:
        """Return (N, H, W, 3) where each pixel's surface is, in the environment's frame; infinite where nothing is.

        Raises:
            ConfigurationError: the camera has neither a depth nor a position channel.
        """
        if Channel.DEPTH not in self._drawn:
            raise self._lacks(Channel.POSITION)
        return point_cloud(self._read(Channel.DEPTH.value), self.intrinsics, self.pose)

    def _lacks(self, channel: Channel) -> ConfigurationError:
        name = getattr(channel, "value", channel)
        return ConfigurationError(
            f"camera '{self.spec.name}' has no {name} channel: add it to the channels of its CameraSpec"
        )

    def _measure(self, env_ids: Tensor | None) -> Values:
        pose = take_rows(self._fixed_pose, env_ids) if self._mount is None else self._mount.pose(env_ids)
        # A copy: the engine's buffer changes with the next step, and the picture does not.
        link_poses = take_rows(self.engine.link_poses, env_ids).clone()
        if self._displaced is not None:
            pose = pose_multiply(pose, take_rows(self._displaced, env_ids))
        camera = self._camera if self._zoom is None else self._zoom.camera
        image = self._picture(camera, pose, link_poses, env_ids)
        if self._zoom is not None:
            image = self._zoom.cut(image, take_rows(self._zoom.fov, env_ids))
        held = {"pose": pose, "link_poses": link_poses}
        return held | {channel.value: self._channel(image, channel) for channel in self._drawn}

    def _picture(self, camera: CameraSpec, pose: Tensor, link_poses: Tensor, env_ids: Tensor | None) -> Image:
        """Return the channels that are drawn, from poses (n, 7) of the camera and (n, L, 7) of links."""
        return self._renderer().render(camera, pose, link_poses, self._drawn, env_ids=env_ids)

    def _channel(self, image: Image, channel: Channel) -> Tensor:
        if channel in self._tables:
            pixels = image.links
            # Links count from 0; the two special indices stand before them.
            if pixels is not None:
                return self._tables[channel][pixels.to(self.device, torch.int64) - TERRAIN]
        else:
            pixels: Tensor | None = getattr(image, channel.value)
            if pixels is not None:
                return pixels.to(self.device)
        raise AssertionError(f"the renderer left out the {channel.value} channel that it was asked for")


def _instance_table(layout: SceneLayout) -> Tensor:
    entities = torch.as_tensor(layout.entity_of_link, dtype=torch.int32)
    first = len(layout.entities)  # deformables count after entities, as they do after links
    deformables = torch.arange(first, first + len(layout.scene.deformables), dtype=torch.int32)
    return torch.cat((torch.tensor((TERRAIN, BACKGROUND), dtype=torch.int32), entities, deformables))


def _semantic_table(layout: SceneLayout) -> Tensor:
    labels = torch.as_tensor(layout.semantic_of_link, dtype=torch.int32)
    terrain = layout.semantic_labels.index("terrain")
    deformables = torch.as_tensor(layout.semantic_of_deformable, dtype=torch.int32)
    return torch.cat((torch.tensor((terrain, BACKGROUND), dtype=torch.int32), labels, deformables))
