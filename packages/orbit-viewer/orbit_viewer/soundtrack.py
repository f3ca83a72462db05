"""Sound of videos: what microphones hear between frames, and its track in the file."""

from __future__ import annotations

import subprocess
import wave
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt
from torch import Tensor

from orbit_core.interfaces import ConfigurationError, StorageError
from orbit_core.sensors.sound import SoundSensor

if TYPE_CHECKING:
    from orbit_core.envs.environment import Environment

# Microphones of one video: left and right.
_CHANNELS = 2
# Share of the full scale that the loudest sample takes.
_PEAK = 0.9
# Hz of the track: AAC's frames of 1,024 samples are then shorter than a video's.
_TRACK_RATE = 48_000


class Soundtrack:
    """Waveforms of an environment's first two microphones, step by step, mixed over some of its environments.

    Args:
        environment: that is filmed.
        rows: (n,) environments that are filmed.

    Raises:
        ConfigurationError: a microphone's period is shorter than a step, whose sound would be lost in part.
    """

    def __init__(self, environment: Environment, rows: Tensor) -> None:
        sensors = environment.world.sensors.values()
        self._sensors = [sensor for sensor in sensors if isinstance(sensor, SoundSensor)][:_CHANNELS]
        self._rows = rows
        self._step = environment.step_dt
        self._heard: list[list[npt.NDArray[np.float32]]] = [[] for _ in self._sensors]
        self._steps = 0
        for sensor in self._sensors:
            rate = sensor.spec.rate
            if rate is not None and rate * self._step > 1.0 + 1e-6:
                raise ConfigurationError(
                    f"microphone '{sensor.spec.name}' measures at {rate:g} Hz, more often than the environment steps: "
                    f"a video's sound needs {1.0 / self._step:g} Hz or a part of it"
                )
        rates = {sensor.sampling_rate for sensor in self._sensors}
        if len(rates) > 1:
            raise ConfigurationError(f"microphones sample at {sorted(rates)} Hz: a video's sound needs one rate")

    def before_step(self) -> None:
        """Take what was heard since the last call, if a period has ended; nothing at the first call."""
        if self._steps:
            for sensor, heard in zip(self._sensors, self._heard, strict=True):
                due = round(self._steps * self._step * sensor.sampling_rate) - sum(map(len, heard))
                if sensor.complete and due > 0:
                    # The first period may have begun before the video.
                    heard.append(sensor.sound[self._rows].sum(0)[-due:].cpu().numpy())
        self._steps += 1

    @property
    def sampling_rate(self) -> int:
        """Hz; zero without a microphone."""
        return self._sensors[0].sampling_rate if self._sensors else 0

    def samples(self) -> npt.NDArray[np.float32]:
        """Return pressures (S, channels) from the first frame on, Pa."""
        tracks = [np.concatenate(heard) if heard else np.zeros(0, np.float32) for heard in self._heard]
        shortest = min(map(len, tracks), default=0)
        return np.stack([track[:shortest] for track in tracks], 1) if shortest else np.zeros((0, 1), np.float32)


def add_track(video: Path, samples: npt.NDArray[np.float32], sampling_rate: int) -> None:
    """Give a video a track of sound, which begins with its first frame.

    The loudest sample takes 0.9 of the full scale: pressures differ by orders of magnitude between scenes.

    Args:
        video: path of the file, which is replaced.
        samples: (S, channels) pressures, Pa.
        sampling_rate: Hz.

    Raises:
        StorageError: the encoder left no whole video, as where the disk is full.
    """
    import imageio_ffmpeg

    sound, joined = video.with_suffix(".wav"), video.with_suffix(".joined.mp4")
    _write_wave(sound, samples, sampling_rate)
    command: Sequence[str] = (
        imageio_ffmpeg.get_ffmpeg_exe(), "-v", "error", "-y", "-i", str(video), "-i", str(sound),
        "-c:v", "copy", "-c:a", "aac", "-ar", str(_TRACK_RATE), str(joined),
    )  # fmt: skip
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    sound.unlink()
    if done.returncode:
        joined.unlink(missing_ok=True)
        raise StorageError(f"cannot add sound to {video.name}: {done.stderr.strip() or 'the encoder failed'}")
    joined.replace(video)


def _write_wave(path: Path, samples: npt.NDArray[np.float32], sampling_rate: int) -> None:
    scaled = samples * (_PEAK * 32767.0 / max(float(np.abs(samples).max()), 1e-9))
    with wave.open(str(path), "wb") as file:
        file.setnchannels(samples.shape[1])
        file.setsampwidth(2)
        file.setframerate(sampling_rate)
        file.writeframes(np.rint(scaled).astype("<i2").tobytes())
