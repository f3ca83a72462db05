"""Tasks of liquids: amounts at the start, cups that are carried and poured from."""

from __future__ import annotations

import pytest
import torch

from orbit_core.envs import make
from orbit_tasks.fluid_pouring import FluidPouring
from orbit_tasks.mdp import fluid

COARSE = {"spacing": 0.01}
"""A cup of 216 particles, for speed."""


def test_a_full_cup_starts_on_its_stand_with_all_of_the_liquid_in_it() -> None:
    environment = make("Fluid-Pouring", 3, "mujoco", seed=0, **COARSE)
    environment.reset(seed=0)
    assert isinstance(environment.task, FluidPouring)
    found = environment.task.metrics(environment)
    assert (fluid.in_cup(environment) == 1.0).all()
    assert (found["poured"] == 0.0).all()
    assert found["spilt"].abs().max() < 1e-6
    cup = fluid.cup_pose(environment)[:, :2]
    stand = environment.world.objects[fluid.STAND].root_pose[:, :2]
    liquid = environment.world.deformables[fluid.LIQUID].positions.mean(1)[:, :2]
    assert cup.std(0).min() > 0.005  # places differ between environments
    torch.testing.assert_close(cup, stand, atol=1e-5, rtol=0.0)
    torch.testing.assert_close(cup, liquid, atol=1e-3, rtol=0.0)
    environment.close()


def test_what_is_in_no_container_is_spilt() -> None:
    environment = make("Fluid-Pouring", 2, "mujoco", seed=0, **COARSE)
    environment.reset(seed=0)
    liquid = environment.world.deformables[fluid.LIQUID]
    places = liquid.positions.clone()
    count = places.shape[1]
    # A quarter of the second environment's liquid is moved off the table.
    places[1, : count // 4, 0] += 1.0
    liquid.set_state(places)
    spilt = environment.task.metrics(environment)["spilt"]
    assert spilt.tolist() == pytest.approx([0.0, (count // 4) / count], abs=1e-6)
    environment.close()


def test_a_hand_carries_a_full_cup_without_spilling() -> None:
    environment = make("Fluid-Transport", 1, "mujoco", seed=0, **COARSE)
    task = environment.task
    expert = task.expert(environment)
    environment.reset(seed=0)
    for _ in range(220):
        environment.step(expert.compute({})["action"])
    assert task.metrics(environment)["kept"] >= 0.95
    assert task.success(environment).all()
    environment.close()


def test_a_hand_pours_a_cup_into_a_container() -> None:
    environment = make("Fluid-Pouring", 1, "mujoco", seed=0, **COARSE)
    task = environment.task
    expert = task.expert(environment)
    environment.reset(seed=0)
    for _ in range(440):
        environment.step(expert.compute({})["action"])
    assert task.metrics(environment)["poured"] >= 0.95
    assert task.success(environment).all()
    environment.close()
