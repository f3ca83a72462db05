"""Counting episodes: whose count, and what they come to."""

from __future__ import annotations

import statistics

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from orbit_core.envs.environment import EpisodeEnd
from orbit_core.rollout.estimates import statistic
from orbit_core.rollout.stepping import EpisodeCounter


def end_of(env_ids: list[int], success: bool, length: int) -> EpisodeEnd:
    count = len(env_ids)
    return EpisodeEnd(
        env_ids=torch.tensor(env_ids),
        observation={},
        success=torch.full((count,), success),
        metrics={"distance": torch.tensor(env_ids, dtype=torch.float32)},
        rewards={"a": torch.full((count,), 1.0), "b": torch.full((count,), 0.5)},
        steps=torch.full((count,), length),
    )


@given(episodes=st.integers(1, 40), num_envs=st.integers(1, 12))
@settings(max_examples=40, deadline=None)
def test_every_environment_counts_its_share(episodes: int, num_envs: int):
    counter = EpisodeCounter(episodes, num_envs)
    for _ in range(-(-episodes // num_envs)):
        assert not counter.complete
        counter.add(end_of(list(range(num_envs)), True, 5))
    assert counter.complete
    assert counter.counted == episodes


@given(data=st.data(), num_envs=st.integers(2, 6), each=st.integers(1, 4))
@settings(max_examples=40, deadline=None)
def test_short_episodes_are_not_preferred(data: st.DataObject, num_envs: int, each: int):
    """Failing environments end their episodes much faster; the success rate must not care in which order they end."""
    failing = num_envs // 2
    counter = EpisodeCounter(num_envs * each, num_envs)
    ends = [env for env in range(num_envs) for _ in range(each * (10 if env < failing else 1))]
    for env in data.draw(st.permutations(ends)):
        counter.add(end_of([env], success=env >= failing, length=1 if env < failing else 10))
    assert counter.complete
    assert counter.episodes().success_rate.value == pytest.approx((num_envs - failing) / num_envs)


def test_episodes_stand_in_the_order_of_their_environments():
    counter = EpisodeCounter(4, 2)
    for env, length in ((1, 3), (1, 4), (0, 9), (1, 5), (0, 8)):
        counter.add(end_of([env], True, length))
    episodes = counter.episodes()
    assert episodes.env_ids.tolist() == [0, 0, 1, 1]
    assert episodes.steps.tolist() == [9, 8, 3, 4]
    assert not counter.running.any()


def test_the_return_is_the_sum_of_all_terms():
    counter = EpisodeCounter(2, 2)
    counter.add(end_of([0, 1], True, 5))
    episodes = counter.episodes()
    assert episodes.returns.tolist() == [1.5, 1.5]
    assert episodes.metrics["distance"].tolist() == [0.0, 1.0]
    assert episodes.success_rate.percent() == "100.0 % [34.2, 100.0]"


@given(st.lists(st.floats(-1e6, 1e6), min_size=1, max_size=20))
@settings(max_examples=40, deadline=None)
def test_mean_and_deviation(values: list[float]):
    result = statistic(values)
    assert result.mean == pytest.approx(statistics.fmean(values), abs=1e-6)
    assert result.deviation == pytest.approx(statistics.pstdev(values), abs=1e-3)
