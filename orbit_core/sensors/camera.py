"""Cameras: colour, depth, positions, normals, segmentation, and points from depth."""

from __future__ import annotations

import math
from collections.abc import Mapping

import torch
from torch import Tensor

from orbit_core.dynamics.indexing import take_rows
from orbit_core.dynamics.transforms import transform_points
from orbit_core.interfaces import BACKGROUND, TERRAIN, ConfigurationError, Image, SceneLayout
from orbit_core.scene import CameraSpec, Channel
from orbit_core.sensors.proprioception import Mount, pose_tensor
from orbit_core.sensors.timed import SensorContext, TimedSensor, Values


def intrinsic_matrix(camera: CameraSpec) -> Tensor:
    """Return (3, 3) pinhole matrix in pixels: u to the right and v down from the image's top left corner.

    Pixel (row, column) has its centre at ``(u, v) = (column + 0.5, row + 0.5)``; pixels are square.
    """
    # Square pixels: one focal length, set by the vertical field of view.
    focal = 0.5 * camera.height / math.tan(0.5 * camera.vertical_fov)
    return torch.tensor([[focal, 0.0, camera.width / 2], [0.0, focal, camera.height / 2], [0.0, 0.0, 1.0]])


def point_cloud(depth: Tensor, intrinsics: Tensor, pose: Tensor | None = None) -> Tensor:
    """Return points (n, H, W, 3) of depth images (n, H, W, 1), infinite where nothing was seen.

    In the camera's frame (-z forward, y up), or in the environment's where the camera's ``pose`` (n, 7) is given.
    """
    height, width = depth.shape[1:3]
    column = torch.arange(width, device=depth.device) + 0.5
    row = torch.arange(height, device=depth.device) + 0.5
    x = ((column - intrinsics[0, 2]) / intrinsics[0, 0]).expand(height, width)
    y = ((row - intrinsics[1, 2]) / intrinsics[1, 1])[:, None].expand(height, width)
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
        """(3, 3) in pixels."""

    @property
    def images(self) -> Mapping[Channel, Tensor]:
        """(N, H, W, channels) of each channel that the camera was specified with."""
        return {channel: self.image(channel) for channel in self._camera.channels}

    def image(self, channel: Channel) -> Tensor:
        """Return (N, H, W, channels)

        Raises:
            ConfigurationError: the camera was specified without that channel.
        """
        if channel not in self._camera.channels:
            raise self._lacks(channel)
        return self.point_cloud() if channel is Channel.POSITION else self._read(channel.value)

    @property
    def pose(self) -> Tensor:
        """(N, 7) in the environment's frame, when the pictures were taken."""
        return self._read("pose")

    @property
    def link_poses(self) -> Tensor:
        """(N, L, 7) of every link of the scene in the environment's frame, when the pictures were taken."""
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
        image = self._renderer().render(self._camera, pose, link_poses, self._drawn, env_ids=env_ids)
        held = {"pose": pose, "link_poses": link_poses}
        return held | {channel.value: self._channel(image, channel) for channel in self._drawn}

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
