"""Videos that a person records in the viewer, and that the browser then saves."""

from __future__ import annotations

import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Protocol

import torch
from torch import Tensor

from orbit_viewer.video import VideoFile

if TYPE_CHECKING:
    from viser import ViserServer

# Pixels of a video, multiples of an encoder's macroblock
_WIDTH, _HEIGHT = 640, 480
_FRAMES_PER_SECOND = 25.0


class FilmCamera(Protocol):
    """Camera of a video, such as :class:`orbit_core.rollout.pictures.Spectator`."""

    def pictures(self, env_ids: Tensor | None = None, seconds: float = 0.0) -> Tensor:
        """Return pictures (n, height, width, 3) uint8 on the CPU."""
        ...

    def close(self) -> None:
        """Free what draws."""
        ...


class Film:
    """Recorder of one environment, while the person wants it.

    Args:
        server: viser's server, through which the browser gets the file.
        title: beginning of the file's name.
        camera: makes the camera, given width and height in pixels.
    """

    def __init__(self, server: ViserServer, title: str, camera: Callable[[int, int], FilmCamera]) -> None:
        self._server, self._title, self._make = server, title, camera
        self._camera: FilmCamera | None = None
        self._file: VideoFile | None = None
        self._path = Path()
        self._since = 0.0
        self.count = 0
        """Videos that were recorded."""

    def after_step(self, recording: bool, index: int, seconds: float) -> None:
        """Film an environment if it is time to, or finish the video.

        Args:
            recording: whether the person wants a video.
            index: of the environment.
            seconds: simulated by the step.
        """
        if not recording:
            if self._file is not None:
                self._finish()
            return
        self._since += seconds
        # Made in the simulation's thread: an OpenGL context belongs to the thread that made it.
        if self._file is None:
            period = max(seconds, 1.0 / _FRAMES_PER_SECOND)
            self._path = Path(tempfile.mkdtemp(prefix="orbit-viewer-")) / "video.mp4"
            self._file = VideoFile(self._path, _WIDTH, _HEIGHT, 1.0 / period)
            self._camera = self._make(_WIDTH, _HEIGHT)
            self._since = period
        if self._since >= 1.0 / _FRAMES_PER_SECOND - 1e-6 and self._camera is not None:
            self._file.add(self._camera.pictures(torch.tensor([index]), self._since)[0].numpy())
            self._since = 0.0

    def discard(self) -> None:
        """Give up a video that was not finished."""
        if self._file is not None:
            self._file.discard()
            self._free()

    def _finish(self) -> None:
        assert self._file is not None
        self._file.close()
        self.count += 1
        self._server.send_file_download(f"{self._title} {self.count}.mp4", self._path.read_bytes())
        self._free()

    def _free(self) -> None:
        if self._camera is not None:
            self._camera.close()
        self._camera = self._file = None
        self._path.unlink(missing_ok=True)
        self._path.parent.rmdir()
