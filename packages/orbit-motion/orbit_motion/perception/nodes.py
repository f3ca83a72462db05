"""Perception as nodes of an agent: from a camera's images to clouds and distance fields."""

from __future__ import annotations

from collections.abc import Mapping
from enum import Enum

import torch
from torch import Tensor

from orbit_core.dynamics.random import RandomStreams
from orbit_core.dynamics.transforms import pose_inverse, pose_multiply
from orbit_core.interfaces import Node, Port
from orbit_core.scene import CameraSpec
from orbit_core.sensors.camera import intrinsic_matrix, point_cloud
from orbit_motion.perception.clouds import PointCloudConfig, sample_point_cloud
from orbit_motion.perception.tsdf import TsdfConfig, TsdfVolume


class CloudFrame(Enum):
    """Frame of a cloud's points."""

    CAMERA = "camera"
    """Camera axes: -z forward, y up."""
    ENVIRONMENT = "environment"
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
        self._intrinsics = intrinsic_matrix(camera).to(device)

    def compute(self, inputs: Mapping[str, Tensor]) -> Mapping[str, Tensor]:
        self.volume.integrate(inputs["depth"], self._intrinsics, inputs["pose"])
        # The field itself, not a copy, because it is large.
        return self.memory()

    def reset(self, env_ids: Tensor | None = None) -> None:
        self.volume.reset(env_ids)

    def memory(self) -> Mapping[str, Tensor]:
        return {"distances": self.volume.distances, "weights": self.volume.weights}
