"""Experts of lifting as teachers: their phase follows from the state, whoever brought it there."""

from __future__ import annotations

import math

import pytest
import torch
from torch import Tensor

from orbit_core.backends import default_backend
from orbit_tasks.mdp import fluid, stages
from tests.tasks.experts import episode


def down(x: float, z: float, turn: float = 0.0) -> Tensor:
    """(1, 7) a hand that points down, turned about the vertical."""
    return torch.tensor([[x, 0.0, z, 0.0, math.cos(turn / 2), math.sin(turn / 2), 0.0]])


def test_a_phase_follows_from_where_the_hand_is_and_what_it_holds() -> None:
    grasp, open_, closed = down(0.5, 0.02), torch.tensor([False]), torch.tensor([True])
    cases = (
        (down(0.3, 0.3), open_, 0),  # far away: above the cube first
        (down(0.5, 0.12), open_, 1),  # above it: down
        (down(0.5, 0.12, turn=0.5), open_, 0),  # above it, but turned
        (down(0.503, 0.022), open_, 2),  # around it: close
        (down(0.503, 0.022), closed, 3),  # it is held: carry it
        (down(0.5, 0.12), closed, 1),  # closed on nothing: down again, with open fingers
    )
    for hand, held, expected in cases:
        assert int(stages.lifting(hand, grasp, held)) == expected, (hand, held)


def test_a_gripper_goes_on_closing_around_a_thing_that_yields() -> None:
    grasp, no, yes = down(0.5, 0.02), torch.tensor([False]), torch.tensor([True])
    cases = (
        (down(0.503, 0.03), no, no, 1),  # 10 mm above its grasp and open: down
        (down(0.503, 0.03), no, yes, 2),  # no longer open: go on closing
        (down(0.503, 0.03), yes, yes, 3),  # it is held: carry it
        (down(0.5, 0.12), no, yes, 1),  # closed on nothing
    )
    for hand, held, closing, expected in cases:
        assert int(stages.lifting(hand, grasp, held, closing)) == expected, (hand, held, closing)


def test_fingers_that_strike_a_handle_do_not_hold_the_cup_yet() -> None:
    opening = torch.tensor([0.9, 0.1, 0.46, 0.48, 0.48])  # on their way; sunk in; at rest, yielding and rigid; too far
    away = torch.tensor([0.006, 0.006, 0.006, 0.012, 0.02])
    assert fluid.gripped(opening, away).tolist() == [False, False, True, True, False]


@pytest.mark.parametrize("task", ["Soft-Lifting", "Fluid-Transport"])
def test_experts_carry_deformables_by_the_state_alone(task: str) -> None:
    environment, success = episode(task, default_backend(), 2, teaches=True, action="ik_relative")
    environment.close()
    assert bool(success.all())


def test_the_expert_lifts_by_the_state_alone() -> None:
    environment, success = episode("Lift", default_backend(), 8, teaches=True, action="ik_relative", episode_length=8.0)
    environment.close()
    assert int(success.sum()) >= 7
