"""Videos of an environment's first episode; the recorder of ``orbit run --video``."""

from __future__ import annotations

import contextlib
import math
from collections.abc import Generator, Sequence
from pathlib import Path
from types import TracebackType
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt
import torch

from orbit_core.files import Replacement, as_path, storage_faults
from orbit_core.installing import install_extra
from orbit_core.interfaces import ConfigurationError, StorageError
from orbit_core.rollout.pictures import Recorder, Spectator
from orbit_viewer.soundtrack import Soundtrack, add_track

if TYPE_CHECKING:
    from orbit_core.envs.environment import Environment

# Pixels; an encoder's macroblock. Other sizes would be rescaled.
_MULTIPLE = 16
# About the most frames in a second of a video; steps in between are not drawn
_FRAMES_PER_SECOND = 25.0


class VideoFile:
    """An H.264 mp4 that grows frame by frame.

    It takes its name only once it is whole: an error or a crash leaves the file that was there before, or none.

    Raises:
        ConfigurationError: the encoder is not installed.
    """

    def __init__(self, path: Path | str, width: int, height: int, frames_per_second: float) -> None:
        if min(width, height) < _MULTIPLE or width % _MULTIPLE or height % _MULTIPLE:
            raise ConfigurationError(f"a video's size must be a multiple of {_MULTIPLE} pixels, not {width} x {height}")
        try:
            import imageio_ffmpeg
        except ImportError as error:
            raise ConfigurationError(f"videos need an encoder: {install_extra('video')}") from error
        self._path = path = as_path(path)
        self._count = imageio_ffmpeg.count_frames_and_secs
        # Written next to the target and renamed at the end, so that there is never half a video.
        self._replacement = Replacement(path)
        self._size = (height, width, 3)
        self._sound: tuple[npt.NDArray[np.float32], int] | None = None
        # The file must not be left open where the camera cannot be made.
        with contextlib.ExitStack() as stack:
            stack.callback(self._replacement.discard)
            stream: Generator[None, Any, None] = imageio_ffmpeg.write_frames(
                str(self._replacement.written),
                (width, height),
                fps=frames_per_second,  # pyright: ignore[reportArgumentType] - any number will do
                macro_block_size=_MULTIPLE,
                quality=7,
            )
            # A generator: the first send starts the encoder.
            stream.send(None)
            stack.pop_all()
        self._stream: Generator[None, Any, None] | None = stream

    def add(self, frame: npt.NDArray[np.uint8]) -> None:
        """Append a frame (height, width, 3)."""
        if self._stream is None:
            raise ConfigurationError(f"video {self._path} is closed: frames come before close()")
        if frame.shape != self._size:
            raise ConfigurationError(f"a frame of video {self._path} must be {self._size}, not {frame.shape}")
        try:
            self._stream.send(np.ascontiguousarray(frame))
        except OSError:
            raise self._no_video() from None

    def set_sound(self, samples: npt.NDArray[np.float32], sampling_rate: int) -> None:
        """Give the video, once it is closed, a track of pressures (S, channels) in Pa from its first frame on."""
        self._sound = samples, sampling_rate

    def close(self) -> None:
        """Finish the file and give it its name; idempotent.

        Raises:
            StorageError: the disk is full, or the folder cannot be written; there is no new file then.
        """
        if self._stream is None:
            return
        try:
            with storage_faults(self._path):
                self._end_stream()
            self._check()
            if self._sound is not None and self._sound[0].any():
                with storage_faults(self._path):
                    add_track(self._replacement.written, *self._sound)
            self._replacement.take_place()
        finally:
            self._replacement.discard()

    def discard(self) -> None:
        """Give the video up; what was written of it is deleted."""
        if self._stream is not None:
            self._end_stream()
        self._replacement.discard()

    def __enter__(self) -> VideoFile:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None):
        if kind is None:
            self.close()
        else:
            self.discard()

    def _check(self) -> None:
        """Read the video: the encoder says nothing of a disk that was full."""
        try:
            self._count(str(self._replacement.written))
        except (RuntimeError, OSError):
            raise self._no_video() from None

    def _no_video(self) -> StorageError:
        return StorageError(f"cannot write {self._path}: the encoder left no whole video, as where the disk is full")

    def _end_stream(self) -> None:
        assert self._stream is not None
        self._stream.close()
        self._stream = None


class VideoRecorder(Recorder):
    """Films the first ``environments`` of a batch, or those of these numbers, side by side, until the video is full.

    The video is as long as an episode's time limit; an environment whose episode ends earlier shows its next one.
    ``frames`` draws axes at the robots' bases, end effectors, finger tips, feet and wheels. It observes a rollout;
    without one, call :meth:`before_step` before each step. The first two microphones are its sound, left and right,
    as loud as the loudest sample allows.
    """

    def __init__(
        self,
        environment: Environment,
        path: Path | str,
        environments: int | Sequence[int] = 4,
        width: int = 400,
        height: int = 304,
        frames: bool = False,
    ) -> None:
        whole = isinstance(environments, int)
        rows = range(min(environments, environment.num_envs)) if whole else environments
        count = len(rows)
        self._rows = torch.tensor([*rows], device=environment.device)
        self._soundtrack = Soundtrack(environment, self._rows)
        self._columns = math.ceil(math.sqrt(count))
        lines = math.ceil(count / self._columns)
        self._length = self._left = environment.max_episode_steps
        # Fast control rates would make videos of hundreds of frames a second.
        self._stride = max(1, round(1.0 / (environment.step_dt * _FRAMES_PER_SECOND)))
        self._period = environment.step_dt * self._stride
        self._file = VideoFile(path, self._columns * width, lines * height, 1.0 / self._period)
        with contextlib.ExitStack() as stack:
            stack.callback(self._file.discard)
            self._camera = Spectator(environment, width, height, frames)
            stack.pop_all()

    @property
    def filmed(self) -> float:
        """Part of the video that is filmed, in [0, 1]."""
        return 1.0 - self._left / self._length

    @property
    def full(self) -> bool:
        """True if the video has its full length; more frames are ignored."""
        return self._left == 0

    def before_step(self) -> None:
        """Film the environments' present state, and take what was heard in the step before."""
        if self.full:
            return
        self._soundtrack.before_step()
        if (self._length - self._left) % self._stride == 0:
            pictures = self._camera.pictures(self._rows, self._period)
            self._file.add(tile(pictures.numpy(), self._columns))
        self._left -= 1

    def close(self) -> None:
        """Finish the file, with sound if the environment has a microphone."""
        self._camera.close()
        self._file.set_sound(self._soundtrack.samples(), self._soundtrack.sampling_rate)
        self._file.close()

    def discard(self) -> None:
        """Give the video up."""
        self._camera.close()
        self._file.discard()


def tile(pictures: npt.NDArray[np.uint8], columns: int) -> npt.NDArray[np.uint8]:
    """Return pictures (n, height, width, 3) in rows of ``columns``, the last row filled up with black."""
    count, height, width, channels = pictures.shape
    lines = math.ceil(count / columns)
    grid = np.zeros((lines * columns, height, width, channels), np.uint8)
    grid[:count] = pictures
    grid = grid.reshape(lines, columns, height, width, channels).swapaxes(1, 2)
    return grid.reshape(lines * height, columns * width, channels)
