"""Jenga: the given block, a tower that falls, settings."""

from __future__ import annotations

from collections.abc import Iterator

import pytest
import torch

from orbit_assets.objects import BLOCK_SIZE as SIZE
from orbit_core.envs import make
from orbit_core.envs.environment import Environment
from orbit_core.interfaces import ConfigurationError
from orbit_tasks import jenga


@pytest.fixture(scope="module")
def environment() -> Iterator[Environment]:
    environment = make("Jenga", 2, "mujoco", seed=0, layers=8)
    yield environment
    environment.close()


def test_the_given_block_lies_in_the_tower_and_stands_out(environment: Environment) -> None:
    environment.reset(seed=0)
    world, task = environment.world, environment.task
    torch.testing.assert_close(jenga.out(world, task), torch.full((2,), 0.03), atol=1e-5, rtol=0.0)
    blocks = torch.cat((jenga.other_positions(world, task), jenga.given_pose(world, task)[:, None, :3]), dim=1)
    apart = torch.cdist(blocks, blocks) + torch.eye(24)
    assert apart.min() > 0.9 * SIZE[2]


def test_a_fallen_tower_costs_its_penalty_and_the_success(environment: Environment) -> None:
    environment.reset(seed=0)
    world, task = environment.world, environment.task
    given = jenga.place(world, task)
    world.objects[jenga.GIVEN].set_root_pose(given)
    assert task.success(world).tolist() == [True, True]
    first = world.objects["block_0"].root_pose.clone()
    first[1, :3] += torch.tensor([0.0, 0.5, -0.02])
    world.objects["block_0"].set_root_pose(first)
    assert task.success(world).tolist() == [True, False]
    torch.testing.assert_close(task.metrics(world)["distance_m"], torch.tensor([0.0, 1.0]), atol=1e-5, rtol=0.0)


def test_a_tower_that_cannot_be_is_refused_by_name() -> None:
    with pytest.raises(ConfigurationError, match="field 'layers' of task Jenga must be 7 to 16"):
        make("Jenga", 1, "mujoco", layers=2)
