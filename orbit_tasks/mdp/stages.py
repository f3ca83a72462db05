"""Phase that fits a state, for experts that pick and place while they teach and another leads.

Phases 0 to 2 are those of :func:`orbit_tasks.mdp.picking.pick`: above the thing, down, close. What counts as there
widens on the way down, so that a phase is not left and entered in turns.
"""

from __future__ import annotations

from collections.abc import Sequence

import torch
from torch import Tensor

from orbit_core.dynamics.transforms import pose_error, rotation_angle, rotation_error

# Metres between the hand and its grasp within which the gripper closes; it holds the thing within twice as much.
_NEAR = 0.008
_ABOVE, _DOWN, _CLOSE = range(3)


def moving(hand: Tensor, grasp: Tensor, place: Tensor, way: Tensor, closed: Tensor) -> Tensor:
    """(N,) int64 of the eight phases of :func:`~orbit_tasks.mdp.picking.pick` and :func:`~orbit_tasks.mdp.picking.put`.

    Args:
        hand: (N, 7) its pose now.
        grasp: (N, 7) its pose around the thing as that is now.
        place: (N, 7) how it is turned at the thing's place.
        way: (N, 3) from the thing to its place.
        closed: (N,) bool, whether the gripper is as narrow as where it holds the thing.
    """
    aside, height = way[:, :2].norm(dim=1), -way[:, 2]
    turn = rotation_error(hand[:, 3:], place[:, 3:]).norm(dim=1)
    # Wider once it is low: a stage that has begun is not left again for a few millimetres.
    over = (aside < torch.where(height < 0.03, 0.015, 0.008)) & (turn < 0.1)
    carried = torch.where(over, 5, torch.where((height < 0.06) & (aside > 0.03), 3, 4))
    carried = torch.where((aside < 0.006) & (height < 0.006), 6, carried)
    return _with_carried(hand, grasp, closed, carried, way.norm(dim=1) < 0.01, 7)


def inserting(hand: Tensor, grasp: Tensor, offset: Tensor, rim: float, fit: float, closed: Tensor) -> Tensor:
    """(N,) int64 of ten phases: above a block, down, close; up, above its hole, nearer, lower, push it in; open, leave.

    Args:
        hand: (N, 7) its pose now.
        grasp: (N, 7) its pose around the block as that stands now.
        offset: (N, 7) the block's pose, as it sees itself at the bottom of its hole.
        rim: metres from there up to the rim.
        fit: metres aside up to which the block may be lowered.
        closed: (N,) bool, whether the gripper is as narrow as where it holds the thing.
    """
    aside, height, turn = offset[:, :2].norm(dim=1), offset[:, 2], rotation_angle(offset[:, 3:])
    low = height < rim + 0.006
    over = (aside < torch.where(low, 0.012, 0.006)) & (turn < 0.08)
    carried = torch.where(over, 5, torch.where((height < rim + 0.01) & (aside > 0.03), 3, 4))
    carried = torch.where(low & (aside < fit) & (turn < 0.03), 6, carried)
    carried = torch.where((height < rim - 0.001) & (aside < 0.005), 7, carried)
    seated = offset[:, :3].norm(dim=1) < 0.004
    return _with_carried(hand, grasp, closed, torch.where(seated, 8, carried), seated, 9)


def lifting(hand: Tensor, grasp: Tensor, closed: Tensor, closing: Tensor | None = None) -> Tensor:
    """(N,) int64 of four phases: above a thing, down, close; carry it.

    Args:
        hand: (N, 7) its pose now.
        grasp: (N, 7) its pose around the thing as that is now.
        closed: (N,) bool, whether the gripper holds.
        closing: (N,) bool, whether the gripper is no longer open. Around a thing that yields it goes on closing, where
            the thing is not held yet.
    """
    carry = torch.full_like(closed, 3, dtype=torch.int64)
    stage = _with_carried(hand, grasp, closed, carry, torch.zeros_like(closed), 3)
    if closing is None:
        return stage
    error = pose_error(hand, grasp)
    around = (error[:, :3].norm(dim=1) < 2.0 * _NEAR) & (error[:, 3:].norm(dim=1) < 0.15)
    return torch.where(closing & around & (stage < carry), _CLOSE, stage)


def following(phases: Sequence[Tensor], done: Tensor, count: int) -> Tensor:
    """(N,) int64 among the phases of all things, ``count`` each: that of the first thing that is not ``done``.

    Args:
        phases: (N,) int64 for each thing, from 0 on.
        done: (N, M) where things are where they belong.
        count: of a thing's phases.
    """
    # Counts the leading ones: things are dealt with in their order, even if a later one is done.
    number = (done > 0).long().cumprod(dim=1).sum(dim=1).clamp(max=len(phases) - 1)
    return torch.stack(tuple(phases), dim=1).gather(1, number[:, None])[:, 0] + count * number


def _with_carried(hand: Tensor, grasp: Tensor, closed: Tensor, carried: Tensor, there: Tensor, leave: int) -> Tensor:
    """(N,) int64: what is held is ``carried`` (N,); of what is not, the hand leaves what is ``there`` (N,)."""
    error = pose_error(hand, grasp)
    aside, turn, way = error[:, :2].norm(dim=1), error[:, 3:].norm(dim=1), error[:, :3].norm(dim=1)
    over = (aside < 0.008 - 0.15 * error[:, 2].clamp_max(0.0)) & (turn < 0.15)
    closed = closed & (way < 2.0 * _NEAR)
    stage = torch.where((way < _NEAR) & (turn < 0.15), _CLOSE, torch.where(over, _DOWN, _ABOVE))
    return torch.where(closed, carried, torch.where(there, leave, stage))
