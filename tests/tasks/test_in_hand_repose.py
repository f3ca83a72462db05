"""In-Hand-Repose: goals that follow one another, drops, hands and objects that it takes."""

from __future__ import annotations

from collections.abc import Iterator

import pytest
import torch

from orbit_assets.object_kinds import BoxConfig
from orbit_core.dynamics import transforms
from orbit_core.envs import Environment, make
from orbit_core.interfaces import ConfigurationError
from orbit_core.mdp import common
from orbit_tasks.in_hand_repose import OBJECT, OFFSETS, InHandRepose


@pytest.fixture(scope="module", params=["mujoco", "bullet"])
def env(request: pytest.FixtureRequest) -> Iterator[Environment]:
    environment = make("In-Hand-Repose", 4, request.param, seed=0)
    yield environment
    environment.close()


def task_of(env: Environment) -> InHandRepose:
    assert isinstance(env.task, InHandRepose)
    return env.task


def turn_to_goal(env: Environment, env_id: int) -> None:
    """Turn one environment's object to its goal, at rest where it lies."""
    item = env.world.objects[OBJECT]
    ids = torch.tensor([env_id])
    pose = torch.cat((item.root_pose[ids, :3], env.commands["goal"][ids]), dim=1)
    item.set_root_pose(pose, ids)
    item.set_root_velocity(torch.zeros(1, 6), ids)


def test_a_goal_is_counted_and_the_next_one_follows(env: Environment) -> None:
    env.reset()
    task = task_of(env)
    for _ in range(20):  # the object falls into the fingers
        env.step(torch.zeros(4, env.action_size))
    goal, state = env.commands["goal"], env.state
    before = goal.clone()
    turn_to_goal(env, 0)
    count = state.count.clone()
    env.step(torch.zeros(4, env.action_size))
    assert state.distance[0] < task.tolerance
    assert state.count[0] == count[0] + 1
    assert transforms.quat_distance(before, goal)[0] > 1e-3
    torch.testing.assert_close(goal[1:], before[1:])


def test_an_object_thrown_out_of_the_hand_ends_the_episode(env: Environment) -> None:
    env.reset()
    pose = env.world.objects[OBJECT].root_pose.clone()
    pose[2, 0] += 0.5
    env.world.objects[OBJECT].set_root_pose(pose)
    _, _, terminated, _, _ = env.step(torch.zeros(4, env.action_size))
    assert terminated.tolist() == [False, False, True, False]


def test_a_held_object_stays_in_the_hand(env: Environment) -> None:
    env.reset()
    for _ in range(60):
        _, _, terminated, _, _ = env.step(torch.zeros(4, env.action_size))
        assert not terminated.any()


def test_rotations_are_uniform(env: Environment) -> None:
    """Of uniform rotations the angle has the density (1 - cos a) / pi, whose mean is pi / 2 + 2 / pi."""
    drawn = torch.cat([common.random_rotations(env.world, None) for _ in range(500)])
    torch.testing.assert_close(drawn.norm(dim=1), torch.ones(2000))
    still = torch.tensor([1.0, 0.0, 0.0, 0.0]).expand_as(drawn)
    mean = transforms.quat_distance(drawn, still).mean().item()
    assert mean == pytest.approx(torch.pi / 2 + 2 / torch.pi, abs=0.05)


@pytest.mark.parametrize(
    ("settings", "words"),
    [
        ({"robot": "franka_panda"}, "no hand of three or more fingers"),
        ({"object": BoxConfig(fixed_base=True)}, "base is fixed"),
    ],
)
def test_what_cannot_be_turned_is_refused(settings: dict[str, object], words: str) -> None:
    with pytest.raises(ConfigurationError, match=words):
        make("In-Hand-Repose", 1, "mujoco", **settings)


@pytest.mark.parametrize(
    ("given", "place"), [({}, OFFSETS["allegro_left"]), ({"offset": (0.01, 0.0, -0.02)}, (0.01, 0.0, -0.02))]
)
def test_a_hand_has_its_own_place_for_the_object_unless_one_is_given(
    given: dict[str, tuple[float, ...]], place: tuple[float, ...]
) -> None:
    environment = make("In-Hand-Repose", 2, "mujoco", robot="allegro_left", **given)
    task, hand = environment.task, common.robot_of(environment.world)
    assert isinstance(task, InHandRepose)
    frame = hand.frame_pose(hand.spec.end_effector.frame)[0, :3]
    torch.testing.assert_close(environment.state.place - frame, torch.tensor(place), atol=2e-3, rtol=0.0)
    environment.close()
