"""What a person sees beside the scene: pictures from the hand that is driven, and from the robot's right."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor

from orbit_core.dynamics.transforms import pose_multiply
from orbit_core.scene import CameraSpec, Channel, Pose, look_at
from orbit_data.teleoperation.driver import Driver

if TYPE_CHECKING:
    from orbit_core.interfaces import Renderer, World

Picture = npt.NDArray[np.uint8]
_HAND = CameraSpec(name="hand view", width=160, height=120, vertical_fov=1.2, far=5.0)
_SIDE = CameraSpec(name="side view", width=160, height=120, vertical_fov=0.8)
# In the end effector's frame, whose z leads out of the hand.
_BESIDE_FINGERS = look_at(eye=(0.1, 0.0, -0.12), target=(0.045, 0.0, 0.03), up=(1.0, 0.0, 0.0))
# m from what is looked at to the camera: before the robot, to its right; the page's own camera stands to its left.
_FROM = (0.75, -0.85, 0.5)


class Views:
    """Draws what a person sees of one environment, whatever cameras the task has.

    Args:
        world: of the environment.
        driver: whose hand is looked from and at.
    """

    def __init__(self, world: World, driver: Driver) -> None:
        self._world, self._driver = world, driver
        self._renderer: Renderer | None = None  # made in the thread that draws
        hand = driver.hand
        self._middle = hand.measured[0, :3].clone() if hand else world.link_poses[0, :, :3].mean(0)
        self.pictures: dict[str, Callable[[], Picture]] = {"side": self._side}
        """Each draws a picture (H, W, 3)."""
        if hand:
            self.pictures = {"hand": self._hand, **self.pictures}

    def close(self) -> None:
        """Free the renderer."""
        if self._renderer is not None:
            self._renderer.close()

    def _hand(self) -> Picture:
        hand = self._driver.hand
        return self._drawn(_HAND, pose_multiply(hand.measured, self._tensor(_BESIDE_FINGERS))) if hand else self._side()

    def _side(self) -> Picture:
        x, y, z = self._middle.tolist()
        eye = (x + _FROM[0], y + _FROM[1], z + _FROM[2])
        return self._drawn(_SIDE, self._tensor(look_at(eye=eye, target=(x, y, z))))

    def _drawn(self, spec: CameraSpec, pose: Tensor) -> Picture:
        world = self._world
        if self._renderer is None:
            self._renderer = world.create_renderer((_HAND, _SIDE))
        markers = world.marker_poses if world.markers else None
        image = self._renderer.render(spec, pose, world.link_poses, (Channel.RGB,), markers)
        assert image.rgb is not None  # it was asked for
        return image.rgb[0].cpu().numpy()

    def _tensor(self, pose: Pose) -> Tensor:
        return torch.tensor([(*pose.position, *pose.orientation)], device=self._world.device)
