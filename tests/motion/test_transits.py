"""Ways of a hand between the parts of a task."""

from __future__ import annotations

from collections.abc import Iterator

import pytest
import torch

from orbit_core.backends import default_backend
from orbit_core.envs import Environment, make
from orbit_core.mdp import common
from orbit_motion.planning import HandTransits

pytest.importorskip("ompl")


@pytest.fixture(scope="module")
def environment() -> Iterator[Environment]:
    made = make("Lift", 2, default_backend(), seed=1)
    yield made
    made.close()


def _transits(environment: Environment) -> HandTransits:
    robot = environment.world.robots[environment.task.agents[0]]
    return HandTransits(environment.world, robot, environment.actions.generators)


def test_a_hand_rises_and_goes_where_it_is_sent(environment: Environment) -> None:
    environment.reset(1)
    transits = _transits(environment)
    start = common.hand_pose(environment).clone()
    target = start.clone()
    target[:, 1] += 0.2
    target[:, 2] -= 0.1
    rows = torch.tensor([True, False])
    transits.begin(target, rows, rows)
    assert transits.active.tolist() == [True, False]
    opened, highest = torch.ones(2, dtype=torch.bool), start[:, 2].clone()
    for _ in range(200):
        action = transits.act(opened)
        if not bool(transits.active.any()):
            break
        environment.step(action.clamp(-1.0, 1.0))
        highest = torch.maximum(highest, common.hand_pose(environment)[:, 2])
    hand = common.hand_pose(environment)
    assert float((hand - target)[0, :3].norm()) < 0.05
    assert float(highest[0] - start[0, 2]) > 0.07
    assert transits.counts.planned == 1


def test_a_pose_out_of_reach_ends_the_way_at_once(environment: Environment) -> None:
    environment.reset(1)
    transits = _transits(environment)
    target = common.hand_pose(environment).clone()
    target[:, 0] += 3.0
    rows = torch.ones(2, dtype=torch.bool)
    transits.begin(target, rows, ~rows)
    assert not bool(transits.active.any())
    assert transits.counts.unreachable == 2
