"""Cameras that cost less than a renderer, or report changes only: ray-cast and event cameras."""

from __future__ import annotations

import torch
from torch import Tensor

from orbit_core.dynamics.indexing import is_mask
from orbit_core.dynamics.transforms import quat_rotate
from orbit_core.interfaces import BACKGROUND, Image
from orbit_core.scene import CameraSpec, Channel, EventCameraSpec, RayCameraSpec
from orbit_core.sensors.camera import CameraSensor, intrinsic_matrix
from orbit_core.sensors.timed import SensorContext, Values

# Grey levels that are added to a pixel's: one level more in the dark is then a change of the logarithm of 0.18, less
# than the default threshold, so that the steps of 8 bits make no events.
_DARK = 5.0
# Shares of red, green and blue in brightness: ITU-R BT.601.
_LUMA = (0.299, 0.587, 0.114)


class RayCamera(CameraSensor):
    """A camera whose pixels are rays that the engine casts against collision shapes.

    Noise is that of depth, in metres, as of any camera.
    """

    def __init__(self, spec: RayCameraSpec, context: SensorContext) -> None:
        super().__init__(spec, context)
        # The carrying link only: a camera sees the rest of its robot, but nothing from within its own housing.
        own = None if self._mount is None else self._mount.link
        self._passed = range(0) if own is None else range(own, own + 1)

    def _picture(self, camera: CameraSpec, pose: Tensor, link_poses: Tensor, env_ids: Tensor | None) -> Image:
        count, height, width = len(pose), camera.height, camera.width
        rays = pixel_directions(camera, self.device)
        # Depth is along the optical axis, and distance along the ray.
        cosines = -rays[:, 2]
        directions = quat_rotate(pose[:, None, 3:], rays).contiguous()
        # From the near plane on, which cuts off what is nearer.
        origins = (pose[:, None, :3] + directions * (camera.near / cosines)[:, None]).contiguous()
        reach = (camera.far - camera.near) / float(cosines.min())
        hits = self.engine.cast_rays_past(origins, directions, reach, self._passed, env_ids)
        depth = camera.near + hits.distances * cosines
        seen = depth <= camera.far

        def shaped(pixels: Tensor) -> Tensor:
            return pixels.reshape(count, height, width, -1)

        links = torch.where(seen, hits.links, BACKGROUND).to(torch.int32)
        return Image(
            depth=shaped(torch.where(seen, depth, torch.inf)),
            normals=shaped(torch.where(seen[..., None], hits.normals, 0.0)),
            links=shaped(links),
        )


def pixel_directions(camera: CameraSpec, device: torch.device) -> Tensor:
    """Return unit vectors (H W, 3) through the middles of a camera's pixels, row after row, in its own frame."""
    focal = float(intrinsic_matrix(camera)[0, 0])
    x = (torch.arange(camera.width, device=device) + 0.5 - 0.5 * camera.width) / focal
    y = (torch.arange(camera.height, device=device) + 0.5 - 0.5 * camera.height) / focal
    down, right = torch.meshgrid(y, x, indexing="ij")
    rays = torch.stack((right, -down, -torch.ones_like(right)), dim=-1).flatten(0, 1)
    return rays / rays.norm(dim=-1, keepdim=True)


class EventCamera(CameraSensor):
    """Events of each pixel since the last measurement: how often its brightness has gone up or down by a threshold.

    Each pixel keeps the logarithm of brightness of its last event, and makes an event for each step of ``threshold``
    from there (Gallego et al., Event-based Vision: A Survey, IEEE PAMI 44, 2022). Brightness between two measurements
    counts as monotonous: give the camera a rate at which it is. The first measurement after a reset has no events.
    """

    def __init__(self, spec: EventCameraSpec, context: SensorContext) -> None:
        super().__init__(spec, context)
        self._threshold = spec.threshold
        self._luma = torch.tensor(_LUMA, device=self.device)

    @property
    def events(self) -> Tensor:
        """Events (N, H, W), int32: their number, positive where it became brighter and negative where darker."""
        return self._read("events")

    @property
    def polarity(self) -> Tensor:
        """Polarity (N, H, W), int8: 1 brighter, -1 darker, 0 without an event."""
        return self.events.sign().to(torch.int8)

    def _measure(self, env_ids: Tensor | None) -> Values:
        values = super()._measure(env_ids)
        brightness = torch.log((values[Channel.RGB.value].float() @ self._luma + _DARK) / (255.0 + _DARK))
        if self._empty or not (env_ids is None or is_mask(env_ids)):
            # Environments that begin: there is no picture before.
            return values | _events(torch.zeros_like(brightness), brightness)
        before = self._held["reference"][0]
        begins = self._waiting if self._some_wait else None
        if begins is not None:
            before = torch.where(begins[:, None, None], brightness, before)
        # Truncated: a pixel's reference moves by whole thresholds, and the rest waits.
        count = torch.trunc((brightness - before) / self._threshold)
        return values | _events(count, before + count * self._threshold)


def _events(count: Tensor, reference: Tensor) -> Values:
    return {"events": count.to(torch.int32), "reference": reference}
