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
from orbit_core.rollout.framing import FIELD_OF_VIEW, FollowingCamera, framed
from orbit_core.rollout.stepping import StepObserver
from orbit_core.scene import STUDIO, CameraSpec, Channel, Pose, Studio

if TYPE_CHECKING:
    from orbit_core.envs.environment import Environment


class OverviewCamera:
    """A spectator's camera in every environment; markers are drawn, and the robots' frames where asked.

    Args:
        world: is seen, from now on.
        width: pixels.
        height: pixels.
        view: pose of the camera in each environment's frame.
        frames: draw axes at the robots' bases, end effectors, finger tips, feet and wheels.
        studio: look of the pictures; None is that of the scene's own cameras.
        follow: entity that the camera moves with; empty leaves it where it is.
        vertical_fov: radians.
    """

    def __init__(
        self,
        world: World,
        width: int,
        height: int,
        view: Pose,
        frames: bool = False,
        studio: Studio | None = None,
        follow: str = "",
        vertical_fov: float = 0.8,
    ) -> None:
        self._world = world
        # Nothing is within a hand's breadth of a spectator, and depth buffers of 16 bits are as fine as this is far.
        self._spec = CameraSpec(
            name="overview", width=width, height=height, vertical_fov=vertical_fov, pose=view, near=0.1
        )
        self._renderer = world.create_renderer((self._spec,), frames, studio)
        self._follower = FollowingCamera(world, follow, view) if follow else None
        pose = torch.tensor((*view.position, *view.orientation), device=world.device)
        self._poses = pose.expand(world.num_envs, 7)

    def pictures(self, env_ids: Tensor | None = None, seconds: float = 0.0) -> Tensor:
        """Return pictures (n, height, width, 3) uint8 on the CPU.

        Args:
            env_ids: environments to draw; all if None.
            seconds: since the pictures before, over which a following camera moves.
        """
        if self._follower is not None:
            self._poses = self._follower.poses(seconds)
        rows = slice(None) if env_ids is None else env_ids
        image = self._renderer.render(
            self._spec,
            self._poses[rows],
            self._world.link_poses[rows],
            (Channel.RGB,),
            self._world.marker_poses[rows] if self._world.markers else None,
            env_ids,
        )
        assert image.rgb is not None  # it was asked for
        return image.rgb.cpu()

    def close(self) -> None:
        """Free the renderer."""
        self._renderer.close()


class Spectator:
    """Camera that films an environment as its task is best seen: dressed, framed, following, with its marks.

    Args:
        environment: is filmed, from its present state on.
        width: pixels.
        height: pixels.
        frames: draw axes at the robots' bases, end effectors, finger tips, feet and wheels.
        studio: look of the pictures.
    """

    def __init__(
        self, environment: Environment, width: int, height: int, frames: bool = False, studio: Studio = STUDIO
    ) -> None:
        self._environment = environment
        world, metadata = environment.world, environment.task.metadata
        environment.task.mark(environment)
        view = framed(world, metadata.view, width / height, metadata.follow)
        self._camera = OverviewCamera(world, width, height, view, frames, studio, metadata.follow, FIELD_OF_VIEW)

    def pictures(self, env_ids: Tensor | None = None, seconds: float = 0.0) -> Tensor:
        """Return pictures (n, height, width, 3) uint8 on the CPU, as :meth:`OverviewCamera.pictures`."""
        self._environment.task.mark(self._environment)
        return self._camera.pictures(env_ids, seconds)

    def close(self) -> None:
        """Free the renderer."""
        self._camera.close()


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
            # A film that an error cut short would pass for the whole.
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
