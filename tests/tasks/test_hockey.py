"""Hockey: the moving net, distances to the net's inside."""

from __future__ import annotations

import torch

from orbit_core.envs import make
from orbit_tasks import hockey
from tests.tasks.experts import episode


def test_the_expert_scores_in_a_moving_net() -> None:
    environment, success = episode("Hockey", "mujoco", 4, moving_goal=True)
    nearest = environment.task.metrics(environment)["distance_m"]
    environment.close()
    assert success.all()
    assert (nearest < 1e-3).all()


def test_the_distance_is_that_to_the_whole_puck_inside() -> None:
    environment = make("Hockey", 3, "mujoco", seed=0)
    world, task = environment.world, environment.task
    line = hockey.net_position(environment)
    pose = world.objects["puck"].root_pose.clone()
    ways = torch.tensor([[-0.1, 0.0], [hockey.RADIUS + 0.01, 0.0], [hockey.RADIUS + 0.01, 0.12]])
    pose[:, :2] = line[:, :2] + ways
    world.objects["puck"].set_root_pose(pose)
    expected = torch.tensor([0.1 + hockey.RADIUS, 0.0, 0.12 - 0.5 * hockey.WIDTH + hockey.RADIUS])
    torch.testing.assert_close(hockey.distance(environment), expected, atol=1e-5, rtol=0.0)
    assert task.success(environment).tolist() == [False, True, False]
    environment.close()
