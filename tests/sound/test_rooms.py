"""Rooms: time of reverberation by Sabine, first reflections by mirror images, the convolution in blocks."""

from __future__ import annotations

import math
import sys

import numpy as np
import pytest
import torch

from orbit_core.interfaces import ConfigurationError
from orbit_sound import Room, reverberation_time, room_responses, sabine_time
from orbit_sound.reverberation import Reverberation

RATE = 16_000


def test_sabines_time_is_0_161_v_over_a() -> None:
    room = Room(size=(5.0, 4.0, 3.0), absorption=0.1)
    assert sabine_time(room) == pytest.approx(0.161 * 60.0 / (94.0 * 0.1), rel=2e-3)


def test_an_exponential_decay_has_its_time_and_a_short_response_is_refused() -> None:
    time = np.arange(2 * RATE) / RATE
    noise = np.random.default_rng(0).standard_normal(len(time))
    assert reverberation_time(noise * np.exp(-6.907755 / 0.5 * time), RATE) == pytest.approx(0.5, rel=0.03)
    with pytest.raises(ConfigurationError, match="decays by 25 dB"):
        reverberation_time(np.zeros(100), RATE)


def test_a_room_reverberates_as_long_as_sabine_says() -> None:
    pytest.importorskip("pyroomacoustics")
    # Nearly a cube: sound is diffuse enough for Sabine's formula, whose own error at this absorption is 8 %.
    room = Room(size=(3.2, 3.0, 2.8), absorption=0.15, order=60)
    (response,) = room_responses(room, np.array([[0.9, 1.1, 1.3]]), (2.3, 1.9, 1.7), RATE)
    assert reverberation_time(response, RATE) == pytest.approx(sabine_time(room), rel=0.15)


def test_the_first_reflection_is_that_of_the_mirror_image_below_the_floor() -> None:
    pytest.importorskip("pyroomacoustics")
    room = Room(size=(20.0, 20.0, 20.0), corner=(-10.0, -10.0, 0.0), absorption=0.36, order=1)
    (response,) = room_responses(room, np.array([[0.0, 0.0, 1.0]]), (3.0, 0.0, 1.0), RATE)
    image = math.hypot(3.0, 2.0)
    peak = int(np.abs(response).argmax())
    assert peak == pytest.approx(image / 343.0 * RATE, abs=1)
    # The pressure that comes back is the root of the energy that is not absorbed.
    around = response[peak - 40 : peak + 41]
    assert np.linalg.norm(around) == pytest.approx(math.sqrt(1.0 - 0.36) / image, rel=0.08)


def test_blocks_add_up_to_the_whole_convolution() -> None:
    generator = torch.Generator().manual_seed(0)
    sound, responses = torch.randn(2, 3, 200, generator=generator), torch.randn(3, 70, generator=generator)
    blocks = Reverberation(responses, 2, 50)
    heard = torch.cat([blocks.add(part) for part in sound.split(50, 2)], 1)
    for row in range(2):
        truth = sum(np.convolve(sound[row, body], responses[body])[:200] for body in range(3))
        assert np.allclose(heard[row], truth, atol=1e-4)


def test_rooms_that_cannot_be_and_a_missing_library_are_named(monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(ConfigurationError, match="absorption above 0 and up to 1"):
        Room(size=(1.0, 1.0, 1.0), absorption=0.0)
    monkeypatch.setitem(sys.modules, "pyroomacoustics", None)
    with pytest.raises(ConfigurationError, match=r"room acoustics need pyroomacoustics: .*orbit-sound\[rooms\]"):
        room_responses(Room(size=(1.0, 1.0, 1.0)), np.full((1, 3), 0.5), (0.4, 0.5, 0.5), RATE)
