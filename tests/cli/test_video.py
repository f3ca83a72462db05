"""Videos take their name only when they are whole."""

from __future__ import annotations

import builtins
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from orbit_core.interfaces import ConfigurationError
from orbit_viewer.video import VideoFile, tile


def test_pictures_are_tiled_in_rows():
    pictures = np.stack([np.full((2, 3, 3), value, np.uint8) for value in (1, 2, 3)])
    grid = tile(pictures, columns=2)
    assert grid.shape == (4, 6, 3)
    assert grid[0, 0, 0] == 1
    assert grid[1, 5, 2] == 2
    assert grid[2, 0, 0] == 3
    assert (grid[2:, 3:] == 0).all()


def frames(video: VideoFile, count: int) -> None:
    for index in range(count):
        video.add(np.full((48, 64, 3), 40 * index, np.uint8))


def test_a_video_holds_its_frames(tmp_path: Path):
    imageio_ffmpeg = pytest.importorskip("imageio_ffmpeg")
    path = tmp_path / "a.mp4"
    with VideoFile(path, 64, 48, 25.0) as video:
        frames(video, 5)
        assert not path.exists()
    count, seconds = imageio_ffmpeg.count_frames_and_secs(str(path))
    assert count == 5
    assert seconds == pytest.approx(0.2, abs=0.05)
    reader = imageio_ffmpeg.read_frames(str(path))
    assert next(reader)["size"] == (64, 48)
    values = [np.frombuffer(frame, np.uint8).mean() for frame in reader]
    assert values == pytest.approx([0, 40, 80, 120, 160], abs=12)
    assert list(tmp_path.iterdir()) == [path]


def test_an_error_leaves_what_was_there(tmp_path: Path):
    path = tmp_path / "a.mp4"
    path.write_bytes(b"before")

    def film() -> None:
        with VideoFile(path, 64, 48, 25.0) as video:
            frames(video, 3)
            raise RuntimeError("the simulation failed")

    with pytest.raises(RuntimeError, match="simulation failed"):
        film()
    assert path.read_bytes() == b"before"
    assert list(tmp_path.iterdir()) == [path]


def test_a_frame_of_another_size_is_refused(tmp_path: Path):
    with VideoFile(tmp_path / "a.mp4", 64, 48, 25.0) as video:
        frames(video, 1)
        with pytest.raises(ConfigurationError, match=r"must be \(48, 64, 3\), not \(64, 48, 3\)"):
            video.add(np.zeros((64, 48, 3), np.uint8))
    with pytest.raises(ConfigurationError, match="multiple of 16"):
        VideoFile(tmp_path / "a.mp4", 65, 48, 25.0)
    with pytest.raises(ConfigurationError, match="multiple of 16"):
        VideoFile(tmp_path / "a.mp4", 64, 0, 25.0)


def test_a_missing_encoder_says_how_to_install_it(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    real = builtins.__import__

    def without(name: str, *arguments: Any) -> Any:
        if name == "imageio_ffmpeg":
            raise ImportError(name)
        return real(name, *arguments)

    monkeypatch.setattr(builtins, "__import__", without)
    with pytest.raises(ConfigurationError, match=r"pip install .*\[video\]"):
        VideoFile(tmp_path / "a.mp4", 64, 48, 25.0)
