"""Pictures and videos of a world as a spectator sees it."""

from __future__ import annotations

import torch
from torch import Tensor

from orbit_core.interfaces import World
from orbit_core.scene import CameraSpec, Channel, Pose


class OverviewCamera:
    """A spectator's camera in every environment; markers are drawn, and the robots' frames where asked."""

    def __init__(self, world: World, width: int, height: int, view: Pose, frames: bool = False) -> None:
        self._world = world
        self._spec = CameraSpec(name="overview", width=width, height=height, vertical_fov=0.8, pose=view)
        self._renderer = world.create_renderer((self._spec,), frames)
        self._pose = torch.tensor((*view.position, *view.orientation), device=world.device)

    def pictures(self, env_ids: Tensor | None = None) -> Tensor:
        """(n, height, width, 3) uint8 on the CPU."""
        rows = slice(None) if env_ids is None else env_ids
        links = self._world.link_poses[rows]
        image = self._renderer.render(
            self._spec,
            self._pose.expand(links.shape[0], 7),
            links,
            (Channel.RGB,),
            self._world.marker_poses[rows] if self._world.markers else None,
            env_ids,
        )
        assert image.rgb is not None  # it was asked for
        return image.rgb.cpu()

    def close(self) -> None:
        """Free the renderer."""
        self._renderer.close()
