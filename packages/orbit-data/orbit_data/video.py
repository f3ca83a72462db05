"""Pictures of many episodes as one video file, from which each frame can be had again."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np

from orbit_core.files import as_path
from orbit_core.installing import install_extra
from orbit_core.interfaces import ConfigurationError
from orbit_data.episodes import Array
from orbit_data.reading.budget import ReadAccount

_EVERY_OTHER = {"g": "2", "crf": "18"}
"""Every second frame stands by itself, so that any one is soon found; nearly no loss that an eye sees."""


_DECODERS = ("h264", "hevc", "libdav1d", "av1", "vp9", "mpeg4")
"""Decoders that datasets use, of the hundreds that the library has."""


def write_video(path: Path | str, stretches: Iterable[Array], rate: int) -> None:
    """Write H.264, of pictures (T, H, W, 3) uint8 one stretch after the other.

    Raises:
        ConfigurationError: the encoder is not installed, or the pictures' sides are odd.
    """
    av = _av()
    with av.open(str(as_path(path)), "w") as file:
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


def read_video(path: Path | str, first: int, count: int, account: ReadAccount) -> Array:
    """Read frames of a video.

    Args:
        path: of an MP4 file.
        first: number of the first frame.
        count: of frames.
        account: that their bytes are counted on.

    Returns:
        (count, H, W, 3) uint8.

    Raises:
        ConfigurationError: the decoder is not installed, or the file is damaged, too short or beyond the budget.
    """
    av, path = _av(), as_path(path)
    done = 0
    limit = {"max_pixels": str(account.budget.pixels)}  # for the decoder, which looks at frames of any size at first
    try:
        # An open file of one format: others name further files, and protocols lead anywhere.
        with path.open("rb") as data, av.open(data, format="mp4", options=limit, stream_options=[limit]) as file:
            stream = file.streams.video[0]
            if stream.codec_context.name not in _DECODERS:
                raise ConfigurationError(
                    f"video {path} is packed by {stream.codec_context.name}, and none of {', '.join(_DECODERS)}"
                )
            account.check_picture(path.name, stream.width, stream.height)
            account.take(path.name, 3 * count * stream.width * stream.height)
            frames = np.empty((count, stream.height, stream.width, 3), np.uint8)
            step = 1.0 / (float(stream.average_rate) * float(stream.time_base))
            file.seek(round(first * step), stream=stream)
            for frame in file.decode(stream):
                account.check_time()
                if round(frame.pts / step) < first:
                    continue
                account.check_picture(path.name, frame.width, frame.height)
                frames[done] = frame.to_ndarray(format="rgb24")
                done += 1
                if done == count:
                    return frames
    except (av.FFmpegError, IndexError, OSError, TypeError, ValueError, ArithmeticError, MemoryError) as error:
        raise ConfigurationError(f"video {path} cannot be read: {error}") from None
    raise ConfigurationError(f"video {path} ends after {first + done} frames, before frame {first + count}")


def _av() -> Any:
    try:
        import av
    except ImportError as error:
        raise ConfigurationError(f"videos of datasets need PyAV: {install_extra('lerobot')}") from error
    return av
