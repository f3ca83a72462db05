"""Gymnasium's own view: ids, its checker, autoreset, final observations, pictures."""

from __future__ import annotations

import warnings

import gymnasium
import numpy as np
import pytest
import torch
from gymnasium.utils.env_checker import check_env
from gymnasium.vector import AutoresetMode

import orbit_core.learning
from orbit_core.backends import default_backend
from orbit_core.interfaces import ConfigurationError
from orbit_core.tasks import task_entries

BACKEND = default_backend()


def test_every_task_has_an_id() -> None:
    orbit_core.learning.register()  # again: harmless
    assert {f"orbit/{name}-v0" for name in task_entries()} <= set(gymnasium.registry)


@pytest.mark.parametrize("task", list(task_entries()))
def test_gymnasiums_checker_passes(task: str) -> None:
    environment = gymnasium.make(f"orbit/{task}-v0", backend=BACKEND)
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        check_env(environment.unwrapped, skip_render_check=True)
    # An unbounded observation box is what the field uses; the checker remarks on it and no more.
    rest = [str(w.message) for w in caught if "infinity" not in str(w.message)]
    assert not rest
    environment.close()


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
