"""What an episode's end looks like to each library: its last observation, not the next one's first."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import pytest
import torch
from tensordict import TensorDict
from torch import Tensor
from torchrl.envs.utils import check_env_specs

from orbit_core.backends import default_backend
from orbit_core.envs import Environment, make
from orbit_learn.ends import EpisodeTally, true_next
from orbit_learn.rl_games import RlGamesEnvironment
from orbit_learn.rsl_rl import RslRlEnvironment
from orbit_learn.sb3 import Sb3Environment
from orbit_learn.skrl import SkrlEnvironment
from orbit_learn.torchrl import TorchRlEnvironment

BACKEND = default_backend()
COUNT, STEPS = 3, 4
"""Environments, and steps of an episode, which for the first environment has begun a step earlier."""


@pytest.fixture
def environment() -> Iterator[Environment]:
    made = make("Reach", COUNT, BACKEND, episode_length=0.02 * STEPS)
    yield made
    made.close()


@pytest.fixture
def twin() -> Iterator[Environment]:
    """The same, stepped as it is."""
    made = make("Reach", COUNT, BACKEND, episode_length=0.02 * STEPS)
    made.reset(seed=1)
    made.task.episode_step[0] = 1
    yield made
    made.close()


def actions(environment: Environment) -> Iterator[Tensor]:
    generator = torch.Generator().manual_seed(0)
    for _ in range(2 * STEPS):
        yield torch.rand(COUNT, environment.action_size, generator=generator) * 2.0 - 1.0


def last_and_next(twin: Environment, action: Tensor) -> tuple[Tensor, Tensor, Tensor, Tensor]:
    """What a step led to, what is seen after it, whose episode ended, and the reward."""
    observation, reward, terminated, truncated, info = twin.step(action)
    led_to = observation["policy"].clone()
    if "final" in info:
        led_to[info["final"].env_ids] = info["final"].observation["policy"]
    assert not terminated.any()
    return led_to, observation["policy"].clone(), truncated, reward


def test_the_true_next_observation_is_an_episodes_last(environment: Environment, twin: Environment) -> None:
    environment.reset(seed=1)
    environment.task.episode_step[0] = 1
    ends = 0
    for action in actions(environment):
        led_to, seen, ended, _ = last_and_next(twin, action)
        observation, *_, info = environment.step(action)
        assert torch.equal(true_next(observation, info)["policy"], led_to)
        assert torch.equal(observation["policy"], seen)
        assert torch.equal((led_to != seen).any(1), ended)
        ends += int(ended.sum())
    assert ends == 2 * COUNT


def test_a_tally_holds_what_episodes_came_to(twin: Environment) -> None:
    """Mean return of those that ended since it was read; before any did, and while none do, what it said before."""
    tally = EpisodeTally(torch.device("cpu"))
    assert np.isnan(tally.read()[:2]).all()
    running, returns = torch.zeros(COUNT), []
    for step, action in enumerate(actions(twin)):
        _, reward, _, truncated, info = twin.step(action)
        running += reward
        returns += running[truncated].tolist()
        running[truncated] = 0.0
        tally.add(info, COUNT)
        if step == STEPS - 1:
            assert tally.read() == (pytest.approx(np.mean(returns)), 0.0, len(returns))
            before, returns = np.mean(returns), []
            assert tally.read()[0] == pytest.approx(before)
    assert tally.read()[0] == pytest.approx(np.mean(returns))


def _of_sb3(environment: Environment) -> Callable[[Tensor], tuple[Tensor, Tensor, Tensor, Tensor]]:
    adapted = Sb3Environment(environment, seed=1)
    adapted.reset()

    def step(action: Tensor) -> tuple[Tensor, Tensor, Tensor, Tensor]:
        observation, reward, done, infos = adapted.step(action.numpy())
        led_to = observation.copy()
        for i, info in enumerate(infos):
            assert ("terminal_observation" in info) == done[i]
            if done[i]:
                assert info["TimeLimit.truncated"]
                led_to[i] = info["terminal_observation"]
        return tuple(torch.as_tensor(values) for values in (led_to, observation, done, reward))  # pyright: ignore

    return step


def _of_skrl(environment: Environment) -> Callable[[Tensor], tuple[Tensor, Tensor, Tensor, Tensor]]:
    adapted = SkrlEnvironment(environment, seed=1)
    adapted.reset()

    def step(action: Tensor) -> tuple[Tensor, Tensor, Tensor, Tensor]:
        seen, reward, _, truncated, extras = adapted.step(action)
        assert torch.equal(adapted.reset()[0], seen)  # it goes on
        return extras["true_next"], seen, truncated[:, 0], reward[:, 0]

    return step


def _of_torchrl(environment: Environment) -> Callable[[Tensor], tuple[Tensor, Tensor, Tensor, Tensor]]:
    adapted = TorchRlEnvironment(environment)
    adapted.set_seed(1)
    state = TensorDict({"policy": environment.observe()["policy"]}, batch_size=[COUNT])

    def step(action: Tensor) -> tuple[Tensor, Tensor, Tensor, Tensor]:
        now, after = adapted.step_and_maybe_reset(state.set("action", action))
        following: Any = now["next"]
        assert torch.equal(following["done"], following["truncated"])
        state.update(after.select("policy"))
        return following["policy"], after["policy"], following["truncated"][:, 0], following["reward"][:, 0]

    return step


@pytest.mark.parametrize("adapt", [_of_sb3, _of_skrl, _of_torchrl])
def test_libraries_that_ask_for_the_last_observation_get_it(
    adapt: Callable[[Environment], Callable[[Tensor], tuple[Tensor, ...]]], environment: Environment, twin: Environment
) -> None:
    step = adapt(environment)
    environment.task.episode_step[0] = 1
    for action in actions(environment):
        for given, expected in zip(step(action), last_and_next(twin, action), strict=True):
            assert torch.equal(given, expected)


def test_libraries_that_value_time_outs_by_the_state_before_them_are_told_of_them(
    environment: Environment, twin: Environment
) -> None:
    """RSL-RL and rl-games."""
    rsl_rl = RslRlEnvironment(environment, seed=1)
    environment.task.episode_step[0] = 1
    rl_games = RlGamesEnvironment(twin, seed=1)
    assert torch.equal(rl_games.reset()["obs"], rsl_rl.get_observations()["policy"])
    twin.task.episode_step[0] = 1
    for action in actions(environment):
        seen, reward, done, extras = rsl_rl.step(action)
        obs, same_reward, same_done, infos = rl_games.step(action)
        assert torch.equal(extras["time_outs"], done.bool())
        assert torch.equal(infos["time_outs"], same_done.bool())
        assert torch.equal(done.bool(), same_done.bool())
        assert torch.equal(seen["policy"], obs["obs"])
        assert torch.equal(reward, same_reward)


def test_torchrls_own_check_passes_and_it_may_reset_some(environment: Environment) -> None:
    adapted = TorchRlEnvironment(environment)
    check_env_specs(adapted)
    before = adapted.rollout(2, break_when_any_done=False)["next", "policy"][:, -1]
    asked = torch.tensor([[False], [True], [False]])
    after = adapted.reset(TensorDict({"policy": before.clone(), "_reset": asked}, batch_size=[COUNT]))["policy"]
    assert torch.equal((after != before).any(1), torch.tensor([False, True, False]))
