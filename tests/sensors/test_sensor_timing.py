"""Rates, delays, held values, resets, noise and snapshots, told by a body that drifts at 1 m/s."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
import torch

from orbit_core.interfaces import ConfigurationError
from orbit_core.scene import FrameSensorSpec, Noise, ObjectSpec, Pose, Scene, SensorSpec, Shape, Sphere, single_link

DT = 0.01


def drift_scene(*sensors: SensorSpec) -> Scene:
    ball = single_link("ball", Shape(Sphere(0.1)), 1.0, np.eye(3) * 0.004)
    drifter = ObjectSpec(name="ball", articulation=ball, pose=Pose((0.0, 0.0, 1.0)))
    return Scene(objects=(drifter,), terrain=(), sensors=sensors, gravity=(0.0, 0.0, 0.0), physics_dt=DT)


def tracker(name: str = "tracker", **timing: Any) -> FrameSensorSpec:
    return FrameSensorSpec(name=name, entity="ball", frame="ball", **timing)


def push(rig: Any, env_ids: torch.Tensor | None = None) -> None:
    count = rig.engine.num_envs if env_ids is None else len(env_ids)
    velocity = torch.tensor([1.0, 0, 0, 0, 0, 0]).repeat(count, 1)
    rig.engine.write_root_state(0, None, velocity, env_ids)


def x_of(rig: Any, name: str = "tracker") -> torch.Tensor:
    return rig.sensors[name].pose[:, 0]


def assert_x(rig: Any, *expected: float) -> None:
    torch.testing.assert_close(x_of(rig), torch.tensor(expected), atol=1e-5, rtol=0)


def test_a_rate_that_does_not_divide_is_refused_with_the_nearest_that_do(make_rig):
    with pytest.raises(ConfigurationError, match=r"'tracker' at 30 Hz .* 100 Hz: take 25 or 33\.3333 Hz"):
        make_rig(drift_scene(tracker(rate=30.0)))
    with pytest.raises(ConfigurationError, match="take 100 Hz"):
        make_rig(drift_scene(tracker(rate=300.0)))
    with pytest.raises(ConfigurationError, match="positive"):
        make_rig(drift_scene(tracker(rate=0.0)))


@pytest.mark.parametrize("delay", [1e9, 1e308, float("inf"), float("nan"), -0.02])
def test_a_delay_beyond_what_is_kept_is_refused(delay: float, make_rig):
    with pytest.raises(ConfigurationError, match=r"'tracker' has a delay of .* from 0 to 200 s, 10000 of its periods"):
        make_rig(drift_scene(tracker(rate=50.0, delay=delay)))


def test_a_delay_must_be_a_multiple_of_the_period(make_rig):
    with pytest.raises(ConfigurationError, match=r"delay of 0\.03 s.*period of 0\.02 s"):
        make_rig(drift_scene(tracker(rate=50.0, delay=0.03)))
    with pytest.raises(ConfigurationError, match="no rate"):
        make_rig(drift_scene(tracker(delay=0.02)))


def test_without_a_rate_the_value_follows_every_step(make_rig):
    rig = make_rig(drift_scene(tracker()))
    push(rig)
    assert_x(rig, 0.0, 0.0)
    rig.step(3)
    assert_x(rig, 0.03, 0.03)


def test_without_a_rate_an_unread_sensor_measures_nothing_and_a_read_one_once(make_rig, monkeypatch):
    rig = make_rig(drift_scene(tracker()))
    sensor, calls = rig.sensors["tracker"], []
    measure = sensor._measure
    monkeypatch.setattr(sensor, "_measure", lambda ids: calls.append(ids) or measure(ids))
    rig.step(5)
    rig.reset(torch.tensor([0]))
    rig.step(5)
    assert not calls
    _ = sensor.pose, sensor.velocity, sensor.pose
    assert len(calls) == 1


def test_with_a_rate_the_value_is_held_between_updates(make_rig):
    rig = make_rig(drift_scene(tracker(rate=25.0)))
    push(rig)
    seen = []
    for _ in range(9):
        rig.step(1)
        seen.append(float(x_of(rig)[0]))
    np.testing.assert_allclose(seen, [0, 0, 0, 0.04, 0.04, 0.04, 0.04, 0.08, 0.08], atol=1e-5)


def test_updates_inside_a_long_step_are_not_missed(make_rig):
    rig = make_rig(drift_scene(tracker(rate=25.0)))
    push(rig)
    rig.step(10)
    assert_x(rig, 0.08, 0.08)


def test_a_delay_holds_measurements_back_by_whole_periods(make_rig):
    rig = make_rig(drift_scene(tracker(rate=50.0, delay=0.04)))
    push(rig)
    seen = []
    for _ in range(5):
        rig.step(2)
        seen.append(float(x_of(rig)[0]))
    np.testing.assert_allclose(seen, [0, 0, 0.02, 0.04, 0.06], atol=1e-5)


@pytest.mark.parametrize("timing", [{}, {"rate": 25.0}, {"rate": 25.0, "delay": 0.08}])
def test_a_reset_environment_reads_fresh_and_the_others_keep_their_value(make_rig, timing):
    rig = make_rig(drift_scene(tracker(**timing)), num_envs=3)
    push(rig)
    rig.step(18)
    before = x_of(rig).clone()
    rig.reset(torch.tensor([1]))
    torch.testing.assert_close(x_of(rig), before * torch.tensor([1.0, 0.0, 1.0]), atol=1e-5, rtol=0)
    assert before[0] > 0.05


def test_a_value_read_before_is_left_alone_by_a_reset(make_rig):
    rig = make_rig(drift_scene(tracker(rate=25.0)))
    push(rig)
    rig.step(4)
    kept = x_of(rig)
    rig.reset(torch.tensor([0]))
    assert_x(rig, 0.0, 0.04)
    torch.testing.assert_close(kept, torch.tensor([0.04, 0.04]), atol=1e-5, rtol=0)


def test_a_delayed_sensor_remembers_nothing_from_before_the_reset(make_rig):
    rig = make_rig(drift_scene(tracker(rate=50.0, delay=0.06)))
    push(rig)
    rig.step(10)
    env = torch.tensor([0])
    rig.reset(env)
    push(rig, env)
    rig.step(4)
    assert_x(rig, 0.0, 0.08)
    rig.step(4)
    assert_x(rig, 0.02, 0.12)


def test_white_noise_has_its_deviation_and_changes_at_every_measurement(make_rig):
    rig = make_rig(drift_scene(tracker(noise=Noise(std=0.1))), num_envs=500)
    first = rig.sensors["tracker"].pose.clone()
    assert torch.equal(first, rig.sensors["tracker"].pose)
    rig.step(1)
    second = rig.sensors["tracker"].pose
    for sample in (first, second):
        assert sample[:, 0].std().item() == pytest.approx(0.1, rel=0.15)
        torch.testing.assert_close(sample[:, 3:].norm(dim=-1), torch.ones(500))
    assert abs(torch.corrcoef(torch.stack((first[:, 0], second[:, 0])))[0, 1].item()) < 0.15


def test_the_bias_stays_for_an_episode_and_is_drawn_anew_at_reset(make_rig):
    rig = make_rig(drift_scene(tracker(noise=Noise(bias_std=0.1))), num_envs=200)
    first = x_of(rig).clone()
    rig.step(1)
    torch.testing.assert_close(x_of(rig), first)
    assert first.std().item() == pytest.approx(0.1, rel=0.2)
    rig.reset(torch.tensor([3]))
    changed = x_of(rig) != first
    assert changed.nonzero().flatten().tolist() == [3]


def test_an_environment_draws_the_same_noise_whatever_their_number(make_rig):
    noisy = drift_scene(tracker(noise=Noise(std=0.1, bias_std=0.1)))
    few, many = make_rig(noisy, num_envs=2), make_rig(noisy, num_envs=5)
    many_first = x_of(many)
    many.reset(torch.tensor([4]))
    _ = x_of(many)
    torch.testing.assert_close(x_of(few), many_first[:2])
    few.step(1)
    many.step(1)
    torch.testing.assert_close(x_of(few), x_of(many)[:2])


@pytest.mark.parametrize("timing", [{}, {"rate": 25.0}, {"rate": 50.0, "delay": 0.04}])
def test_readings_repeat_after_a_snapshot_is_loaded(make_rig, timing):
    rig = make_rig(drift_scene(tracker(noise=Noise(std=0.1, bias_std=0.1), **timing)))
    push(rig)
    sensor = rig.sensors["tracker"]

    def continuation() -> torch.Tensor:
        readings = []
        for i in range(6):
            rig.step(2)
            if i == 3:
                rig.reset(torch.tensor([1]))
            readings.append(sensor.pose.clone())
        return torch.stack(readings)

    rig.step(4)
    state = rig.engine.save_state(), rig.random.save_state(), sensor.save_state()
    once = continuation()
    rig.engine.load_state(state[0])
    rig.random.load_state(state[1])
    sensor.load_state(state[2])
    torch.testing.assert_close(continuation(), once)
