"""Nut-Bolt: what counts, and who refuses the task."""

from __future__ import annotations

import pytest
import torch

from orbit_core.envs import make
from orbit_core.interfaces import Capability, ConfigurationError, UnsupportedCapabilityError
from orbit_tasks import nut_bolt


def test_a_nut_a_turn_above_its_place_is_not_screwed_down() -> None:
    environment = make("Nut-Bolt", 2, "mujoco", seed=0, turns=0.5, thread="boxes")
    world, task = environment.world, environment.task
    pose = torch.cat((nut_bolt.place(environment), torch.tensor([[1.0, 0.0, 0.0, 0.0]] * 2)), dim=1)
    pose[1, 2] += task.lead
    world.objects["nut"].set_root_pose(pose)
    assert task.success(environment).tolist() == [True, False]
    torch.testing.assert_close(task.metrics(environment)["distance_m"], torch.tensor([0.0, 0.004]), atol=1e-5, rtol=0.0)
    environment.close()


def test_engines_without_distance_fields_refuse_the_task() -> None:
    with pytest.raises(UnsupportedCapabilityError, match=rf"{Capability.SIGNED_DISTANCE_FIELDS.value}.*mujoco"):
        make("Nut-Bolt", 1, "bullet")
    environment = make("Nut-Bolt", 1, "bullet", thread="boxes")  # which looks whether the nut lies still
    world = environment.world
    assert not nut_bolt.dropped(environment).any()
    for height, turn in ((0.0, (1.0, 0.0)), (nut_bolt.HEIGHT, (0.0, 1.0)), (0.5 * nut_bolt.WIDTH, (0.7071, 0.7071))):
        lying = torch.tensor([[0.4, 0.3, height, *turn, 0.0, 0.0]])
        world.objects["nut"].set_root_pose(lying)
        assert nut_bolt.dropped(environment).all()
    environment.close()


def test_turns_that_the_bolt_lacks_are_refused_by_name() -> None:
    with pytest.raises(ConfigurationError, match="field 'turns' of task NutBolt must be"):
        make("Nut-Bolt", 1, "mujoco", turns=9.0)
    with pytest.raises(ConfigurationError, match="field 'thread' of task Nut-Bolt must be 'field' or 'boxes'"):
        make("Nut-Bolt", 1, "mujoco", thread="wood")
    with pytest.raises(ConfigurationError, match=r"no lead below 0\.004: take thread=boxes"):
        make("Nut-Bolt", 1, "mujoco", lead=0.002)


@pytest.mark.parametrize("backend", ["mujoco", "warp"])
def test_a_nut_falls_freely_onto_the_thread_of_the_bolt_below_it(backend: str) -> None:
    environment = make("Nut-Bolt", 1, backend, seed=0)
    world, task = environment.world, environment.task
    above = torch.cat((nut_bolt.place(environment), torch.tensor([[1.0, 0.0, 0.0, 0.0]])), dim=1)
    above[:, 2] += 0.013  # the tip of the bolt is in the nut, whose convex pieces lie around it
    world.objects["nut"].set_root_pose(above)
    world.objects["nut"].set_root_velocity(torch.zeros(1, 6))
    steps = round(0.03 / task.physics_dt)
    for _ in range(steps):
        world.step()
    fallen = above[0, :3] - world.objects["nut"].root_pose[0, :3]
    expected = 0.5 * 9.81 * task.physics_dt**2 * steps * (steps + 1)
    torch.testing.assert_close(fallen, torch.tensor([0.0, 0.0, expected]), atol=2e-4, rtol=0.0)
    environment.close()
