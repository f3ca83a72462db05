"""Gymnasium's own view: ids, its checker, autoreset, final observations, pictures."""

from __future__ import annotations

import subprocess
import sys
import warnings
from dataclasses import dataclass

import gymnasium
import numpy as np
import pytest
import torch
from gymnasium.utils.env_checker import check_env
from gymnasium.vector import AutoresetMode
from gymnasium.wrappers.vector import NormalizeReward, RecordEpisodeStatistics
from stable_baselines3 import PPO

import orbit_learn.gymnasium
from orbit_assets.terrain import Rough, TerrainGrid
from orbit_core.backends import default_backend
from orbit_core.envs import RewardTerm, make, task_entries
from orbit_core.envs.captured_step import CapturedStep
from orbit_core.interfaces import ConfigurationError, UnknownNameError
from orbit_core.mdp import common
from orbit_learn.registration import register
from orbit_tasks.reach import Reach

BACKEND = default_backend()


def test_every_task_has_an_id() -> None:
    register()  # again: harmless
    assert {f"orbit/{name}-v0" for name in task_entries()} <= set(gymnasium.registry)


@pytest.mark.parametrize("first", ["orbit_learn", "gymnasium"])
def test_tasks_have_their_ids_whichever_is_imported_first_and_gymnasium_only_when_it_is_used(first: str) -> None:
    second = {"orbit_learn": "gymnasium", "gymnasium": "orbit_learn"}[first]
    code = f"import sys, {first}; early = 'gymnasium' in sys.modules; import {second}, gymnasium;"
    code += "print(early, 'orbit/Lift-v0' in gymnasium.registry)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.split() == [str(first == "gymnasium"), "True"]


CHEAP = {"Nut-Bolt": {"thread": "boxes"}, "Jenga": {"layers": 7}}
"""Fields of tasks whose scenes take long to step."""


@pytest.mark.rotates
@pytest.mark.parametrize("task", list(task_entries()))
def test_gymnasiums_checker_passes(task: str) -> None:
    environment = gymnasium.make(f"orbit/{task}-v0", backend=BACKEND, **CHEAP.get(task, {}))
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        check_env(environment.unwrapped, skip_render_check=True)
    # An unbounded observation box is what the field uses; the checker remarks on it and no more. What a processor's MKL
    # lacks is no matter of the task's.
    rest = [
        str(w.message) for w in caught if not any(text in str(w.message) for text in ("infinity", "matrix products"))
    ]
    assert not rest
    environment.close()


def test_fields_at_any_depth_are_options_of_make() -> None:
    grid = TerrainGrid(kinds=(Rough(),), levels=2, cell_size=4.0)
    environment = gymnasium.make(
        "orbit/Velocity-Rough-v0", backend=BACKEND, robot="unitree_go2", terrain=grid, **{"rewards.flight.weight": 0.1}
    )
    task = environment.unwrapped.environment.task
    assert (task.robot, task.terrain, task.rewards.flight.weight) == ("unitree_go2", grid, 0.1)
    observation, _ = environment.reset(seed=0)
    assert observation["policy"].shape == environment.observation_space["policy"].shape == (48 + 187,)
    environment.close()
    with pytest.raises(UnknownNameError, match="did you mean 'terrain'"):
        gymnasium.make("orbit/Velocity-Rough-v0", backend=BACKEND, terain=grid)


def test_a_vector_environment_gives_tensors_and_resets_in_the_same_step() -> None:
    environment = gymnasium.make_vec(
        "orbit/Lift-v0", num_envs=4, backend=BACKEND, robot="franka_panda", action="ik_relative", episode_length=0.1
    )
    assert environment.metadata["autoreset_mode"] is AutoresetMode.SAME_STEP
    observation, _ = environment.reset(seed=0)
    assert observation["policy"].shape == environment.observation_space["policy"].shape
    assert isinstance(observation["policy"], torch.Tensor)
    for _ in range(5):
        action = torch.as_tensor(environment.action_space.sample())
        observation, reward, _, truncated, info = environment.step(action)
    assert truncated.all()
    assert info["_final_obs"].all()
    assert info["final_obs"]["policy"].shape == observation["policy"].shape
    assert set(info["final_info"]) == {"success", "steps", "goal_distance_m"}
    assert isinstance(reward, torch.Tensor)
    environment.close()


def test_gymnasiums_own_wrappers_take_a_vector_environment_of_numpy_arrays() -> None:
    """Its statistics and its normalisation of rewards compute with NumPy, and raise where rewards are tensors."""
    environment = gymnasium.make_vec("orbit/Reach-v0", num_envs=2, backend=BACKEND, episode_length=0.06, numpy=True)
    wrapped = RecordEpisodeStatistics(NormalizeReward(environment))
    observation, _ = wrapped.reset(seed=0)
    assert observation["policy"] in environment.observation_space["policy"]
    for _ in range(3):
        observation, reward, _, truncated, info = wrapped.step(wrapped.action_space.sample())
    assert truncated.tolist() == [True, True]
    assert info["episode"]["l"].tolist() == [3, 3]
    arrays = (observation["policy"], reward, info["final_obs"]["policy"], info["final_info"]["success"])
    assert all(isinstance(array, np.ndarray) for array in arrays)
    wrapped.close()


def test_a_single_environment_shows_the_end_of_its_episode() -> None:
    environment = gymnasium.make("orbit/Reach-v0", backend=BACKEND, episode_length=0.06)
    environment.reset(seed=0)
    zero = np.zeros(environment.action_space.shape, np.float32)
    for _ in range(3):
        observation, reward, terminated, truncated, info = environment.step(zero)
    assert truncated
    assert not terminated
    assert isinstance(reward, float)
    assert observation["policy"].dtype == np.float32
    assert {"success", "position_error_m", "rotation_error_rad"} <= set(info)
    environment.close()


@pytest.mark.parametrize("captured", [False, True])
def test_a_single_environment_waits_for_reset_and_skips_no_episode(captured: bool) -> None:
    """As one of a batch begins its episodes, so does it; in between it shows how the last one ended."""
    kept = {"backend": BACKEND, "episode_length": 0.06, "seed": 3}
    single = orbit_learn.gymnasium.SingleEnvironment("Reach", render_mode="rgb_array", **kept)
    inner = single.environment
    inner._closed = CapturedStep(inner, compile=False, whole=False, renews=False) if captured else None
    batch = make("Reach", num_envs=1, **kept)
    begun, action = batch.reset()[0], np.ones(single.action_space.shape, np.float32)
    for _ in range(3):
        seen, _ = single.reset()
        np.testing.assert_allclose(seen["policy"], begun["policy"][0], atol=1e-5)
        for _ in range(batch.max_episode_steps):
            seen, _, _, truncated, info = single.step(action)
            begun, *_, ended = batch.step(torch.as_tensor(action)[None])
        assert truncated
        assert info["success"] == bool(ended["final"].success)
        np.testing.assert_allclose(seen["policy"], ended["final"].observation["policy"][0], atol=1e-5)
        np.testing.assert_allclose(single.environment.observe()["policy"][0], seen["policy"], atol=1e-5)
        with pytest.raises(ConfigurationError, match="the episode is over: reset the environment, then step"):
            single.step(action)
    before = single.render()
    single.reset()
    assert (single.render() != before).any(), "the last frame was that of the episode's end"
    single.close(), batch.close()
    with pytest.raises(ConfigurationError, match="autoreset=False is for one environment"):
        make("Reach", num_envs=2, backend=BACKEND, autoreset=False)


def test_pictures_are_drawn() -> None:
    environment = gymnasium.make("orbit/Lift-v0", backend=BACKEND, render_mode="rgb_array")
    environment.reset(seed=0)
    picture = environment.render()
    assert picture.shape == (480, 640, 3)
    assert picture.dtype == np.uint8
    assert picture.std() > 10
    environment.close()


def test_an_unknown_render_mode_is_refused() -> None:
    with pytest.raises(ConfigurationError, match="render_mode 'human' is unknown"):
        gymnasium.make_vec("orbit/Lift-v0", num_envs=1, backend=BACKEND, render_mode="human")


@dataclass
class Height:
    """Twice the height of the hand, in metres, a second."""

    height: RewardTerm | None = RewardTerm(lambda env: common.hand_pose(env)[:, 2], 2.0)


def test_the_policy_gradient_climbs_in_a_vector_environment() -> None:
    """REINFORCE (Williams, 1992), by hand: the mean return of 64 environments' episodes rises by a quarter."""
    torch.manual_seed(0)
    task = Reach(rewards=Height(), episode_length=0.5)
    environment = orbit_learn.gymnasium.VectorEnvironment(task, num_envs=64, backend=BACKEND)
    mean = torch.zeros(environment.single_action_space.shape, requires_grad=True)
    optimizer = torch.optim.Adam([mean], lr=0.1)
    environment.reset(seed=0)
    returns = []
    for _ in range(12):
        action = torch.normal(mean.detach().expand(64, -1), 0.5)
        total = torch.zeros(64)
        for step in range(25):
            _, reward, _, truncated, info = environment.step(action)
            total += reward
            assert truncated.all() == (step == 24)
        assert set(info) == {"final_obs", "_final_obs", "final_info", "_final_info"}
        advantage = (total - total.mean()) / total.std()
        optimizer.zero_grad()
        (0.5 * ((action - mean) / 0.5).square().sum(1) * advantage).mean().backward()
        optimizer.step()
        returns.append(total.mean().item())
    assert returns[-1] > 1.25 * returns[0]
    environment.close()


def test_a_library_learns_in_a_single_environment() -> None:
    """Stable-Baselines3 as it is, which wraps Gymnasium's environments itself."""
    task = Reach(rewards=Height(), episode_length=0.5)
    environment = orbit_learn.gymnasium.SingleEnvironment(task, backend=BACKEND)
    settings = {"n_steps": 250, "batch_size": 125, "gamma": 0.9, "learning_rate": 3e-3, "seed": 0}
    model = PPO("MultiInputPolicy", environment, policy_kwargs={"ortho_init": False}, **settings)
    model.learn(250)
    assert model.ep_info_buffer
    before = np.mean([episode["r"] for episode in model.ep_info_buffer])
    model.learn(2000)
    after = np.mean([episode["r"] for episode in list(model.ep_info_buffer)[-10:]])
    assert after > 1.2 * before
    environment.close()
