"""Dishwasher: the expert, the door before the rack, the seal, and what the asset is."""

from __future__ import annotations

import math

import pytest
import torch

from orbit_assets.objects import dishwasher
from orbit_core.envs import make
from orbit_core.scene import Scene
from orbit_core.world import simulate
from orbit_tasks.dishwasher import THING
from tests.tasks.experts import episode


def test_the_expert_of_another_arm_opens_the_door_and_pulls_the_rack() -> None:
    environment, success = episode("Dishwasher", "mujoco", 2, robot="jaco2", episode_length=8.0)
    end = environment.metrics()
    environment.close()
    assert success.all()
    assert (end["door_lacks_rad"] == 0.0).all()
    assert (end["rack_lacks_m"] < 0.02).all()
    assert (end["premise_shut"] == 1.0).all()


def test_the_rack_counts_only_once_the_door_is_open() -> None:
    environment = make("Dishwasher", 3, "mujoco", seed=0)
    world, task = environment.world, environment.task
    goal = environment.commands["goal"][:, 0]
    joints = torch.tensor([[0.5, 0.0], [1.4, 0.0], [1.4, 0.0]])
    joints[:, 1] = goal
    joints[2, 1] += 0.03
    world.objects[THING].set_joint_state(joints)
    end = task.metrics(environment)
    torch.testing.assert_close(end["door_lacks_rad"], torch.tensor([0.8, 0.0, 0.0]))
    torch.testing.assert_close(end["rack_lacks_m"], torch.stack((goal[0], goal[1] * 0.0, goal[2] * 0.0 + 0.03)))
    assert task.success(environment).tolist() == [False, True, False]
    environment.close()


@pytest.mark.parametrize("backend", ["mujoco", "bullet", "sapien"])
def test_the_seal_holds_the_door_and_the_door_holds_the_rack(backend: str) -> None:
    """Pulled at the bar by less and by more than the seal holds there; and the rack against the shut door."""
    world = simulate(Scene(objects=(dishwasher(seal=25.0),)), 3, backend)
    thing = world.objects["dishwasher"]
    link, about = thing.find_links("door")[0], 0.27
    held = 25.0 * 0.22 / about
    wrench = torch.zeros(3, 1, 6)
    wrench[:, 0, 4] = -torch.tensor([0.8, 1.6, 0.0]) * held * about
    thing.set_wrenches(wrench, [link])
    pull = torch.zeros(3, 1, 6)
    pull[2, 0, 0] = -10.0
    thing.set_wrenches(pull, thing.find_links("rack"))
    world.step(300)
    door, rack = thing.joint_positions.unbind(1)
    assert abs(float(door[0])) < 0.01
    assert float(door[1]) > 1.45
    # The rack's bar meets the door 3 cm on; the seal holds more than it pulls.
    assert float(rack[2]) < 0.04
    assert abs(float(door[2])) < 0.05
    assert math.isclose(float(rack[0]), 0.0, abs_tol=0.005)
    world.close()
