"""Where Lift's cubes start and its goals are."""

from __future__ import annotations

import pytest
import torch

from orbit_core.backends import default_backend
from orbit_core.cli.making import make_environment
from orbit_core.cli.settings import EnvironmentSettings
from orbit_core.envs import make
from orbit_core.envs.observation_layout import terms_of_group
from orbit_core.interfaces import ConfigurationError, OrbitError
from orbit_core.mdp.sensing import with_cameras
from orbit_core.scene import CameraSpec
from orbit_tasks.lift import Lift, LiftGoal, narrowed


def starts(start_spread: float, goal_spread: float) -> tuple[torch.Tensor, torch.Tensor]:
    task = Lift(start_spread=start_spread)
    task.commands.goal = LiftGoal(spread=goal_spread)
    environment = make(task, num_envs=64, backend=default_backend())
    try:
        environment.reset(seed=1)
        return environment.world.objects["cube"].root_pose.clone(), environment.commands["goal"].clone()
    finally:
        environment.close()


@pytest.fixture(scope="module")
def usual() -> tuple[torch.Tensor, torch.Tensor]:
    return starts(1.0, 1.0)


def test_one_start_and_one_goal_are_in_the_middle_of_all(usual: tuple[torch.Tensor, torch.Tensor]) -> None:
    cubes, goals = starts(0.0, 0.0)
    for fixed, spread in zip((cubes, goals), usual, strict=True):
        torch.testing.assert_close(fixed, fixed[:1].expand_as(fixed), atol=1e-6, rtol=0.0)
        low, high = spread[:, :3].amin(0), spread[:, :3].amax(0)
        assert bool(((fixed[0, :3] >= low - 1e-3) & (fixed[0, :3] <= high + 1e-3)).all())


def test_half_the_spread_halves_the_way_to_the_middle(usual: tuple[torch.Tensor, torch.Tensor]) -> None:
    middle, goal = starts(0.0, 0.0)
    cubes, goals = starts(0.5, 0.5)
    torch.testing.assert_close(cubes[:, :2], 0.5 * (middle[:, :2] + usual[0][:, :2]), atol=1e-5, rtol=0.0)
    torch.testing.assert_close(goals, 0.5 * (goal + usual[1]), atol=1e-5, rtol=0.0)


@pytest.mark.parametrize("spread", [-0.1, 1.5, float("nan")])
def test_a_spread_is_a_share(spread: float) -> None:
    with pytest.raises(ConfigurationError, match="between 0 and 1"):
        narrowed((0.0, 1.0), spread)


def test_cameras_take_the_place_of_the_state_that_they_show() -> None:
    task = Lift()
    with_cameras(task, {"front": (84, 60)})
    terms = terms_of_group(task.observations.policy)
    assert list(terms) == ["joint_positions", "joint_velocities", "hand_pose", "goal", "last_action", "front_color"]
    (camera,) = terms["front_color"].sensors
    assert isinstance(camera, CameraSpec)
    assert (camera.width, camera.height) == (84, 60)


def test_a_camera_that_policies_cannot_see_is_named() -> None:
    with pytest.raises(OrbitError, match="unknown camera 'back' in task Lift: known: front, hand"):
        with_cameras(Lift(), {"back": (84, 84)})


@pytest.mark.parametrize("words", [("front",), ("front:84",), ("front:84x",), ("front:8x8", "front:9x9")])
def test_a_camera_on_the_command_line_is_a_name_and_a_size(words: tuple[str, ...]) -> None:
    with pytest.raises(ConfigurationError, match="such as front:84x84"):
        make_environment(EnvironmentSettings(task="Lift", backend=default_backend(), cameras=words), 1)
