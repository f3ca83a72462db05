"""Hockey: the expert on two engines, the moving net, distances to the net's inside."""

from __future__ import annotations

import pytest
import torch

from orbit_core.envs import make
from orbit_tasks import hockey
from tests.tasks.experts import episode


@pytest.mark.parametrize(
    ("backend", "num_envs", "moving"), [("mujoco", 4, False), ("mujoco", 4, True), ("bullet", 2, False)]
)
def test_the_expert_scores(backend: str, num_envs: int, moving: bool) -> None:
    environment, success = episode("Hockey", backend, num_envs, moving_goal=moving)
    nearest = environment.task.metrics(environment.world)["distance_m"]
    environment.close()
    assert success.all()
    assert (nearest < 1e-3).all()


def test_the_distance_is_that_to_the_whole_puck_inside() -> None:
    environment = make("Hockey", 3, "mujoco", seed=0)
    world, task = environment.world, environment.task
    line = hockey.net_position(world, task)
    pose = world.objects["puck"].root_pose.clone()
    ways = torch.tensor([[-0.1, 0.0], [hockey.RADIUS + 0.01, 0.0], [hockey.RADIUS + 0.01, 0.12]])
    pose[:, :2] = line[:, :2] + ways
    world.objects["puck"].set_root_pose(pose)
    expected = torch.tensor([0.1 + hockey.RADIUS, 0.0, 0.12 - 0.5 * hockey.WIDTH + hockey.RADIUS])
    torch.testing.assert_close(hockey.distance(world, task), expected, atol=1e-5, rtol=0.0)
    assert task.success(world).tolist() == [False, True, False]
    environment.close()
