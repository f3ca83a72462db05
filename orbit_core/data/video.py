"""Pictures of many episodes as one video file, from which each frame can be had again."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np

from orbit_core.data.episodes import Array
from orbit_core.interfaces import ConfigurationError

_EVERY_OTHER = {"g": "2", "crf": "18"}
"""Every second frame stands by itself, so that any one is soon found; nearly no loss that an eye sees."""


_LARGEST = 1 << 26
"""Pixels of a picture."""


def write_video(path: Path, stretches: Iterable[Array], rate: int) -> None:
    """Write H.264, of pictures (T, H, W, 3) uint8 one stretch after the other.

    Raises:
        ConfigurationError: the encoder is not installed, or the pictures' sides are odd.
    """
    av = _av()
    with av.open(str(path), "w") as file:
        stream: Any = None
        for frames in stretches:
            if stream is None:
                height, width = frames.shape[1:3]
                if height % 2 or width % 2:
                    raise ConfigurationError(f"a video's sides are even, and these pictures are {width} x {height}")
                stream = file.add_stream("libx264", rate=rate, options=_EVERY_OTHER)
                stream.width, stream.height, stream.pix_fmt = width, height, "yuv420p"
            for frame in frames:
                picture = av.VideoFrame.from_ndarray(np.ascontiguousarray(frame), format="rgb24")
                file.mux(stream.encode(picture))
        if stream is not None:
            file.mux(stream.encode())


def read_video(path: Path, first: int, count: int) -> Array:
    """Frames (count, H, W, 3) uint8 of a video, from the one of that number on.

    Raises:
        ConfigurationError: the decoder is not installed, or the file is damaged or too short.
    """
    av = _av()
    frames: list[Array] = []
    try:
        with av.open(str(path)) as file:
            stream = file.streams.video[0]
            if stream.width * stream.height > _LARGEST:
                raise ConfigurationError(f"video {path} has pictures of {stream.width} x {stream.height}, too large")
            step = 1.0 / (float(stream.average_rate) * float(stream.time_base))
            file.seek(round(first * step), stream=stream)
            for frame in file.decode(stream):
                if round(frame.pts / step) >= first:
                    frames.append(frame.to_ndarray(format="rgb24"))
                if len(frames) == count:
                    return np.stack(frames)
    except (av.FFmpegError, IndexError, OSError) as error:
        raise ConfigurationError(f"video {path} cannot be read: {error}") from None
    raise ConfigurationError(f"video {path} ends after {first + len(frames)} frames, before frame {first + count}")


def _av() -> Any:
    try:
        import av
    except ImportError as error:
        raise ConfigurationError("videos of datasets need PyAV: pip install 'orbit-core[lerobot]'") from error
    return av
