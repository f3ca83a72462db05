"""Pictures of a world from a spectator's camera, and recorders that film a rollout."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import cache
from pathlib import Path
from types import TracebackType
from typing import TYPE_CHECKING, Self

import torch
from torch import Tensor

from orbit_core.interfaces import World
from orbit_core.registry import Registry
from orbit_core.rollout.stepping import StepObserver
from orbit_core.scene import CameraSpec, Channel, Pose

if TYPE_CHECKING:
    from orbit_core.envs.environment import Environment


class OverviewCamera:
    """A spectator's camera in every environment; markers are drawn, and the robots' frames where asked."""

    def __init__(self, world: World, width: int, height: int, view: Pose, frames: bool = False) -> None:
        self._world = world
        self._spec = CameraSpec(name="overview", width=width, height=height, vertical_fov=0.8, pose=view)
        self._renderer = world.create_renderer((self._spec,), frames)
        self._pose = torch.tensor((*view.position, *view.orientation), device=world.device)

    def pictures(self, env_ids: Tensor | None = None) -> Tensor:
        """Return (n, height, width, 3) uint8 on the CPU."""
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


class Recorder(StepObserver):
    """Base of observers that film a rollout; as a context it keeps the film unless an error ends it."""

    @property
    def filmed(self) -> float:
        """Part of the film that is there, in [0, 1]."""
        raise NotImplementedError

    def close(self) -> None:
        """Finish the file."""
        raise NotImplementedError

    def discard(self) -> None:
        """Give the film up."""
        raise NotImplementedError

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None):
        if kind is None:
            self.close()
        else:
            self.discard()


@cache
def recorders() -> Registry[Callable[..., Recorder]]:
    """Return recorders by name, from the entry-point group ``orbit.recorders``."""
    return Registry("recorder", "orbit.recorders")


def video_recorder(
    environment: Environment,
    path: Path | str,
    environments: int | Sequence[int] = 4,
    width: int = 400,
    height: int = 304,
    frames: bool = False,
) -> Recorder:
    """Return a recorder of a video, :class:`orbit_viewer.video.VideoRecorder`.

    Args:
        environment: to film, from its task's own view.
        path: of the mp4 file.
        environments: how many are filmed side by side, the first ones, or their numbers.
        width: pixels of each environment's picture, a multiple of 16.
        height: pixels, likewise.
        frames: draw axes at the robots' bases, end effectors, finger tips, feet and wheels.

    Raises:
        UnknownNameError: orbit-viewer, which brings it, is not installed.
        ConfigurationError: the size cannot be, or the encoder is not installed.
    """
    # Found by its name: an encoder takes long to load, and most runs film nothing.
    return recorders().get("video")(environment, path, environments, width, height, frames)
