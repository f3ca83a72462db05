"""Recordings, replays and throughput, on one backend."""

from __future__ import annotations

from pathlib import Path

import pytest

from orbit_conformance.replay import replay
from orbit_conformance.tasks import compare_recordings, run_task
from orbit_conformance.throughput import measure_once
from orbit_core.backends import default_backend
from orbit_core.interfaces import AssetError, ConfigurationError

SHORT = {"episode_length": 1.0}


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
