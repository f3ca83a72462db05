"""Rooms: responses of a box-shaped room by image sources (pyroomacoustics), and times of reverberation."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from orbit_core.installing import install_command
from orbit_core.interfaces import ConfigurationError
from orbit_core.scene.pose import Vector3
from orbit_sound.modes import SPEED_OF_SOUND

_Samples = npt.NDArray[np.float64]


@dataclass(frozen=True, kw_only=True)
class Room:
    """A box-shaped room.

    Raises:
        ConfigurationError: a number is out of its range.
    """

    size: Vector3
    """Extents along x, y and z, m."""
    corner: Vector3 = (0.0, 0.0, 0.0)
    """Corner of least coordinates, in the environment's frame."""
    absorption: float = 0.2
    """Share of the energy that walls, floor and ceiling absorb: 0.02 tiles, 0.1 plaster, 0.3 carpet and curtains."""
    order: int = 20
    """Most reflections that are followed."""

    def __post_init__(self) -> None:
        numbers = all(math.isfinite(value) for value in (*self.size, *self.corner, self.absorption))
        if not numbers or min(self.size) <= 0.0 or not 0.0 < self.absorption <= 1.0 or not 0 <= self.order <= 60:
            raise ConfigurationError(
                f"a room needs a size above zero, an absorption above 0 and up to 1, and an order from 0 to 60, not "
                f"{self}"
            )

    def contains(self, point: Sequence[float]) -> bool:
        """Return True if a point of the environment's frame is within the walls."""
        inside = np.asarray(point, float) - np.asarray(self.corner)
        return bool((inside > 0.0).all() and (inside < np.asarray(self.size)).all())


def sabine_time(room: Room) -> float:
    """Return the time in s in which sound decays by 60 dB, by Sabine's formula."""
    x, y, z = room.size
    surface = 2.0 * (x * y + y * z + z * x)
    # 24 ln 10 / c is Sabine's 0.161 s/m.
    return 24.0 * math.log(10.0) / SPEED_OF_SOUND * x * y * z / (surface * room.absorption)


def room_responses(
    room: Room, sources: npt.NDArray[np.floating], microphone: Sequence[float], sampling_rate: int
) -> _Samples:
    """Return impulse responses (S, L) of a room without the direct sound; 1 is the direct level at 1 m.

    Args:
        room: walls.
        sources: (S, 3) m in the environment's frame.
        microphone: (3,) m, likewise.
        sampling_rate: Hz.

    Raises:
        ConfigurationError: pyroomacoustics is not installed, or a point is outside of the room.
    """
    for name, point in [("microphone", microphone), *((f"source {i}", each) for i, each in enumerate(sources))]:
        if not room.contains(point):
            at = ", ".join(f"{value:g}" for value in point)
            raise ConfigurationError(
                f"the {name} at ({at}) m is outside of the room of {room.size} m from {room.corner}: move one of them"
            )
    whole, direct = (_simulate(room, sources, microphone, sampling_rate, order) for order in (room.order, 0))
    distances = np.linalg.norm(sources - np.asarray(microphone), axis=1)
    length = max(len(each) for each in whole)
    responses = np.zeros((len(sources), length))
    for row, (reflected, alone) in enumerate(zip(whole, direct, strict=True)):
        responses[row, : len(reflected)] = reflected
        responses[row, : len(alone)] -= alone
        # Versions of the library differ by 4 pi in the level at 1 m; the filter of a fractional delay has the energy 1.
        responses[row] /= np.linalg.norm(alone) * distances[row]
    return responses


def reverberation_time(response: npt.NDArray[np.floating], sampling_rate: int) -> float:
    """Return the time in s in which a response (L,) decays by 60 dB: Schroeder's integral from -5 to -25 dB.

    Raises:
        ConfigurationError: the response ends before it has decayed by 25 dB.
    """
    energy = np.cumsum(np.square(response)[::-1])[::-1]
    sounding = energy[energy > 0.0]
    level = 10.0 * np.log10(sounding / sounding[0]) if sounding.size else np.zeros(1)
    within = np.flatnonzero((level <= -5.0) & (level >= -25.0))
    if level.min() > -25.0 or within.size < 2:
        raise ConfigurationError("a reverberation time needs a response that decays by 25 dB: take a longer one")
    slope = np.polyfit(within / sampling_rate, level[within], 1)[0]
    return float(-60.0 / slope)


def _simulate(
    room: Room, sources: npt.NDArray[np.floating], microphone: Sequence[float], sampling_rate: int, order: int
) -> list[_Samples]:
    acoustics = _acoustics()
    box = acoustics.ShoeBox(
        list(room.size), fs=sampling_rate, materials=acoustics.Material(room.absorption), max_order=order
    )
    corner = np.asarray(room.corner)
    for source in sources:
        box.add_source(np.asarray(source) - corner)
    box.add_microphone(np.asarray(microphone) - corner)
    box.compute_rir()
    # Its filters of fractional delays are centred late.
    late = acoustics.constants.get("frac_delay_length") // 2
    return [np.asarray(each)[late:] for each in box.rir[0]]


def _acoustics() -> Any:
    """Return pyroomacoustics, loaded on first use: it takes seconds."""
    try:
        import pyroomacoustics
    except ImportError as error:
        raise ConfigurationError(
            f"room acoustics need pyroomacoustics: {install_command('orbit-sound[rooms]')}"
        ) from error
    return pyroomacoustics
