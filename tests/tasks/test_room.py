"""Room-Reorganization: the room is drawn anew, what counts, and what the paths must not touch is told."""

from __future__ import annotations

from collections.abc import Iterator

import pytest
import torch

from orbit_core.envs import make
from orbit_core.envs.environment import Environment
from orbit_core.interfaces import PlanningError
from orbit_tasks import room
from orbit_tasks import room_reorganization as tasks
from orbit_tasks.mobile import stand_at


@pytest.fixture(scope="module")
def environment() -> Iterator[Environment]:
    made = make("Room-Reorganization", 16, "mujoco", seed=1)
    yield made
    made.close()


def test_things_stand_on_furniture_and_their_places_on_the_shelf(environment: Environment) -> None:
    environment.reset(seed=1)
    task, world = environment.task, environment.world
    assert isinstance(task, tasks.RoomReorganization)
    halves = torch.tensor(tasks.HALF_HEIGHTS)
    heights = tasks.positions(environment)[..., 2]
    torch.testing.assert_close(heights, (environment.state.surface + halves).expand(16, 3))
    torch.testing.assert_close(
        environment.state.places[..., 2], (environment.state.surface + tasks.SHELF_RAISED + halves).expand(16, 3)
    )
    assert (environment.state.places[..., 0] > 0.5 * room.LENGTH - room.SHELF.depth).all()
    apart = torch.cdist(environment.state.places, environment.state.places) + torch.eye(3)
    assert (apart > 0.2).all()
    assert (world.objects["desk"].root_pose[:, 0].std() > 0.3).all()
    assert not tasks.in_place(environment).any()


def test_a_thing_in_its_place_counts_once_the_hand_has_let_go(environment: Environment) -> None:
    environment.reset(seed=1)
    task, world = environment.task, environment.world
    assert isinstance(task, tasks.RoomReorganization)
    for number, name in enumerate(tasks.THINGS):
        pose = world.objects[name].root_pose.clone()
        pose[:, :3] = environment.state.places[:, number]
        world.objects[name].set_root_pose(pose)
        share = (number + 1) / 3
        torch.testing.assert_close(tasks.share_in_place(environment), torch.full((16,), share))
    assert task.success(environment).all()


def test_a_base_that_stands_in_furniture_is_told_in_which(environment: Environment) -> None:
    environment.reset(seed=1)
    expert = environment.expert()
    crate = environment.world.objects["crate"].root_pose[:, :3].clone()
    stand_at(environment.world, crate, torch.arange(16))
    with pytest.raises(PlanningError, match=r"the base's start .* of 'crate'"):
        expert.compute({})
