"""Recordings, replays, confidence intervals and throughput, on one backend."""

from __future__ import annotations

import math
from pathlib import Path

import pytest

from orbit_core.backends import default_backend
from orbit_core.conformance.estimates import mean, proportion
from orbit_core.conformance.replay import replay
from orbit_core.conformance.tasks import compare_recordings, run_task
from orbit_core.conformance.throughput import measure_once
from orbit_core.interfaces import AssetError, ConfigurationError

SHORT = {"episode_length": 1.0}


def test_wilsons_interval_is_the_published_one() -> None:
    """Newcombe, Two-sided confidence intervals for the single proportion, Statistics in Medicine 17 (1998), table I."""
    for successes, trials, low, high in ((81, 263, 0.2553, 0.3662), (15, 148, 0.0624, 0.1605), (0, 20, 0.0, 0.1611)):
        found = proportion(successes, trials)
        assert (found.low, found.high) == pytest.approx((low, high), abs=6e-5)


def test_the_interval_of_a_mean_shrinks_with_the_sample() -> None:
    values = [math.sin(7.0 * n) for n in range(400)]
    few, many = mean(values[:25]), mean(values)
    assert few.low < few.value < few.high
    assert many.high - many.low < 0.5 * (few.high - few.low)
    # Half the interval is about two standard errors: sqrt(1/2) / sqrt(400) each.
    assert many.high - many.low == pytest.approx(4 * 0.7071 / 20, rel=0.15)


def test_a_replay_on_the_same_backend_repeats_what_was_recorded(tmp_path: Path) -> None:
    path = tmp_path / "reach.npz"
    result = run_task("Reach", default_backend(), num_envs=3, fields=SHORT, recording=path, tracked_envs=2)
    again = replay(path, default_backend())
    assert again.result == result
    assert {part.thing for part in again.divergence} == {"robot/panda_hand_tcp"}
    assert max(max(part.upper_quartile) for part in again.divergence) == 0.0
    assert again.divergence[0].times[-1] == pytest.approx(0.98)


def test_recordings_of_different_runs_are_not_compared(tmp_path: Path) -> None:
    paths = [tmp_path / f"{seed}.npz" for seed in (0, 1)]
    for seed, path in enumerate(paths):
        run_task("Reach", default_backend(), num_envs=2, seed=seed, fields=SHORT, recording=path)
    with pytest.raises(ConfigurationError, match="seed is 0 here and 1 there"):
        compare_recordings(*paths)
    paths[0].write_bytes(b"no recording")
    with pytest.raises(AssetError, match="no recording"):
        compare_recordings(*paths)


def test_throughput_tells_the_layer_from_the_engine() -> None:
    pytest.importorskip("psutil")
    rate = measure_once("Reach", default_backend(), num_envs=2, blocks=2, block_steps=5)
    assert rate.raw is not None
    assert 0.0 < rate.raw.ratio < 2.0
    assert rate.env_steps_per_second == pytest.approx(2e3 / rate.milliseconds_per_step)
    assert sum(rate.shares.values()) == pytest.approx(1.0)
    assert min(rate.shares.values()) > 0.0
    assert rate.start_seconds > 0.0
