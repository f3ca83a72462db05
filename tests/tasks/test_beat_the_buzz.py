"""Beat-The-Buzz: the expert, touches that count, what is covered, rods."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from orbit_assets.pegs import ring_on_handle, spline
from orbit_core.envs import make
from orbit_core.interfaces import AssetError, ConfigurationError
from orbit_core.mdp import common
from orbit_tasks import beat_the_buzz
from tests.tasks.experts import episode


@pytest.mark.parametrize(("rod", "robot"), [("easy", "jaco2"), ("hard", "franka_panda")])
def test_the_expert_covers_the_rod_without_a_touch(rod: str, robot: str) -> None:
    environment, success = episode("Beat-The-Buzz", "mujoco", 2, rod=rod, robot=robot, episode_length=5.0)
    task = environment.task
    length = (len(environment.state.rings) - 1) * environment.state.spacing
    covered = task.metrics(environment)["covered_m"]
    environment.close()
    assert success.all()
    assert (covered > length - 0.01).all()


@pytest.mark.parametrize("backend", ["mujoco", "bullet"])
def test_a_touch_counts_once_and_costs(backend: str) -> None:
    environment = make("Beat-The-Buzz", 2, backend, seed=0)
    world, task = environment.world, environment.task
    hold = torch.zeros(2, environment.action_size)
    environment.step(hold)
    assert environment.state.touches.tolist() == [0.0, 0.0]
    free = world.objects["rod"].root_pose.clone()
    # The second environment's rod is shifted forward, which is across the ring, 2 mm into its bars.
    inside = beat_the_buzz.RADIUS - beat_the_buzz.BAR - beat_the_buzz.THICKNESS
    across = common.hand_pose(environment)[1, 0] - beat_the_buzz.at_rod(environment)[1, 0]
    pushed = free.clone()
    pushed[1, 0] += across + inside + 0.002
    world.objects["rod"].set_root_pose(pushed)
    for _ in range(3):
        environment.step(hold)
    assert environment.state.touches.tolist() == [0.0, 1.0]
    world.objects["rod"].set_root_pose(free)
    for _ in range(20):
        environment.step(hold)
    world.objects["rod"].set_root_pose(pushed)
    environment.step(hold)
    assert environment.state.touches.tolist() == [0.0, 2.0]
    metric = task.metrics(environment)["covered_m"]
    torch.testing.assert_close(metric, environment.state.covered - torch.tensor([0.0, 2.0 * task.penalty]))
    assert not task.success(environment).any()
    environment.close()


def test_the_course_is_even_and_goes_through_its_corners() -> None:
    corners = [(0.0, 0.2, 0.0), (0.03, 0.1, 0.04), (0.0, 0.0, 0.0), (-0.03, -0.1, 0.02)]
    course = spline(corners, 0.002)
    steps = np.linalg.norm(np.diff(course.points, axis=0), axis=1)
    np.testing.assert_allclose(steps, course.spacing, rtol=2e-3)
    np.testing.assert_allclose(np.linalg.norm(course.tangents, axis=1), 1.0)
    for corner in corners:
        assert np.linalg.norm(course.points - corner, axis=1).min() < course.spacing
    straight = spline([(0.0, 0.0, 0.0), (0.3, 0.0, 0.4)], 0.01)
    np.testing.assert_allclose(straight.tangents, np.tile((0.6, 0.0, 0.8), (len(straight.points), 1)), atol=1e-9)


def test_what_cannot_be_is_refused() -> None:
    with pytest.raises(ConfigurationError, match=r"no rod is called 'bent': choose one of easy, medium, hard"):
        beat_the_buzz.course_of("bent")
    with pytest.raises(AssetError, match="two corners or more"):
        spline([(0.0, 0.0, 0.0), (0.0, 0.0, 0.0)], 0.01)
    with pytest.raises(AssetError, match="bars thinner than its radius"):
        ring_on_handle("ring", 0.03, 0.04, 0.1)
