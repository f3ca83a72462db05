"""Sensors of a world whose values a robot measures itself: cameras and inertial units."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import torch
from torch import Tensor

from orbit_core.dynamics.indexing import take_rows
from orbit_core.interfaces import ConfigurationError, Image, Renderer
from orbit_core.scene import CameraSpec, Channel, ImuSpec
from orbit_core.sensors.timed import SensorContext, TimedSensor, Values
from orbit_deploy.link import RobotLink, RobotLinkError
from orbit_deploy.pictures import PictureKind, PictureView

_KINDS = {Channel.RGB: PictureKind.RGB, Channel.DEPTH: PictureKind.DEPTH}


class PictureRenderer(Renderer):
    """Renderer whose pictures a robot's cameras take.

    Args:
        link: session with the robot's computer.
        since: returns ns on the robot's clock before which pictures show what is no longer so.
    """

    def __init__(self, link: RobotLink, since: Callable[[], int]) -> None:
        self._link, self._since = link, since
        self._cameras = {each.name: each for each in link.description.cameras}
        self._views: dict[str, PictureView] = {}

    def render(
        self,
        camera: CameraSpec,
        camera_poses: Tensor,
        link_poses: Tensor,
        channels: Sequence[Channel],
        marker_poses: Tensor | None = None,
        env_ids: Tensor | None = None,
    ) -> Image:
        own, link = self._cameras[camera.name], self._link
        if camera.name not in self._views:
            self._views[camera.name] = PictureView(camera, own)
        try:
            pictures = {
                channel.value: self._views[camera.name].see(link.picture(own, _KINDS[channel], self._since()))
                for channel in channels
            }
        except ConfigurationError as error:
            # A policy must not act on what it saw long ago.
            link.stop()
            raise RobotLinkError(f"{error}: the robot at {link.address} is stopped") from None
        return Image(**pictures)


class MeasuredImu(TimedSensor):
    """Inertial unit of the robot, in the axes in which it measures. Noise goes on both values.

    Args:
        spec: of the task; the robot's unit has its name.
        context: of the world.
        read: returns the newest measurement: orientation (w, x, y, z), angular velocity and linear acceleration (10).
    """

    noisy = ("angular_velocity", "linear_acceleration")

    def __init__(self, spec: ImuSpec, context: SensorContext, read: Callable[[], Sequence[float]]) -> None:
        super().__init__(spec, context)
        self._newest = read

    @property
    def angular_velocity(self) -> Tensor:
        """Angular velocity (N, 3), rad/s."""
        return self._read("angular_velocity")

    @property
    def linear_acceleration(self) -> Tensor:
        """Linear acceleration (N, 3), m/s^2: at rest it points up."""
        return self._read("linear_acceleration")

    def _measure(self, env_ids: Tensor | None) -> Values:
        numbers = torch.tensor(self._newest(), dtype=torch.float32, device=self.device)[None]
        return {
            "angular_velocity": take_rows(numbers[:, 4:7], env_ids),
            "linear_acceleration": take_rows(numbers[:, 7:], env_ids),
        }
