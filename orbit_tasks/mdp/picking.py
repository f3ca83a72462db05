"""Poses and phases of scripted experts that pick things up and put them elsewhere."""

from __future__ import annotations

import math
from dataclasses import replace

import torch
from torch import Tensor

from orbit_core.dynamics.transforms import quat_rotate, quat_rotate_inverse
from orbit_core.envs import Environment
from orbit_core.envs.terms import TermFunction
from orbit_core.interfaces import World
from orbit_core.mdp import common
from orbit_motion.experts.expert import Phase, Retry

_QUARTER = 0.5 * math.pi
# Metres from a hand's middle, along its fingers' way, across it and up, within which its palm meets another thing of a
# few centimetres: a Franka hand's is 0.2 wide.
_PALM = (0.135, 0.07, 0.04)


def quarter_yaw(orientation: Tensor) -> Tensor:
    """(...,) rad, at most an eighth of a turn: by how much a square thing is turned about the vertical."""
    return quarter(2.0 * torch.atan2(orientation[..., 3], orientation[..., 0]))


def quarter(yaw: Tensor) -> Tensor:
    """The same turns (...,) of a square thing, rad, at most an eighth of a turn."""
    return yaw - _QUARTER * torch.round(yaw / _QUARTER)


def over_square(position: Tensor, orientation: Tensor) -> Tensor:
    """(N, 7) the hand at positions (N, 3), pointing down, along the nearest faces of square things (N, 4)."""
    return torch.cat((position, common.facing_down(quarter_yaw(orientation))), dim=1)


def grasp_square(pose: Tensor) -> Tensor:
    """(N, 7) the hand around a square thing (N, 7) from above, along the faces that need the least turn."""
    return over_square(pose[:, :3], pose[:, 3:])


def beside(hand: Tensor, other: Tensor) -> Tensor:
    """(N, 7) a hand (N, 7) that points down, turned by a quarter where its palm would meet a thing at (N, 3)."""
    yaw, way = common.wrapped(common.turn_facing_down(hand[:, 3:])), other - hand[:, :3]
    along = (way[:, 1] * yaw.cos() - way[:, 0] * yaw.sin()).abs()
    across = (way[:, 0] * yaw.cos() + way[:, 1] * yaw.sin()).abs()
    meets = (along < _PALM[0]) & (across < _PALM[1]) & (way[:, 2] > _PALM[2])
    yaw = torch.where(meets, yaw - _QUARTER * torch.where(yaw > 0.0, 1.0, -1.0), yaw)
    return torch.cat((hand[:, :3], common.facing_down(yaw)), dim=1)


def least_turn(before: Tensor, after: Tensor) -> Tensor:
    """(N,) rad: how to turn a hand that takes a thing now and leaves it elsewhere, so that it turns least in all.

    Args:
        before: (N, K) rad of the hand's turns at which it may take the thing.
        after: (N, K) rad of its turns when it leaves it.
    """
    before = common.wrapped(before)
    # The larger of both turns decides, as a joint limit at either end stops the hand.
    most = torch.maximum(before.abs(), common.wrapped(after).abs())
    return before.gather(1, most.argmin(1, keepdim=True)).squeeze(1)


def raised(target: TermFunction, height: float) -> TermFunction:
    """The pose that ``target`` gives, higher by ``height`` metres."""

    def pose(env: Environment) -> Tensor:
        up = torch.tensor([0.0, 0.0, height, 0.0, 0.0, 0.0, 0.0], device=env.device)
        return target(env) + up

    return pose


def back(target: TermFunction, way: float) -> TermFunction:
    """The pose of a hand that ``target`` gives, ``way`` metres back out of where the hand points."""

    def pose(env: Environment) -> Tensor:
        hand = target(env)
        shift = torch.tensor([0.0, 0.0, -way], device=env.device).expand(len(hand), 3)
        return torch.cat((hand[:, :3] + quat_rotate(hand[:, 3:], shift), hand[:, 3:]), dim=1)

    return pose


def straight_up(height: float) -> TermFunction:
    """The hand as it is, at ``height`` metres in the environment's frame."""

    def pose(env: Environment) -> Tensor:
        hand = common.hand_pose(env)
        return torch.cat((hand[:, :2], torch.full_like(hand[:, :1], height), hand[:, 3:]), dim=1)

    return pose


def hand_for(place: TermFunction, held: TermFunction) -> TermFunction:
    """The hand with which what it holds is at its place, as that sits in the hand now.

    Args:
        place: (N, 7) where the thing's frame shall be, and how the hand shall then be turned.
        held: (N, 7) of the thing now; its turn in the hand is kept.
    """

    def pose(env: Environment) -> Tensor:
        hand, goal = common.hand_pose(env), place(env)
        inside = quat_rotate_inverse(hand[:, 3:], held(env)[:, :3] - hand[:, :3])
        return torch.cat((goal[:, :3] - quat_rotate(goal[:, 3:], inside), goal[:, 3:]), dim=1)

    return pose


def pick(world: World, grasp: TermFunction, clearance: float = 0.1, free: bool = False) -> tuple[Phase, ...]:
    """Go above a grasp (N, 7), down to it, and close the gripper. ``free``: the way there is."""
    closing = max(0.4, common.closing_time(world))
    return (
        Phase(raised(grasp, clearance), position_tolerance=0.02, timeout=4.0, free=free),
        Phase(grasp, position_tolerance=0.006, timeout=1.5, least=0.02),
        Phase(grasp, gripper_open=False, dwell=closing, timeout=closing + 0.1),
    )


def put(
    place: TermFunction,
    height: float,
    clearance: float = 0.1,
    over: float = 0.015,
    came: Retry | None = None,
) -> tuple[Phase, ...]:
    """Carry what is held, ``height`` metres above the origin, to its place, let go, and leave straight up.

    Args:
        place: (N, 7) of the hand, such as :func:`hand_for` gives.
        height: of the hand on the way, in metres in the environment's frame.
        clearance: metres above the place at which the hand arrives.
        over: metres within which it is there before it goes down: less than what is free next to the place.
        came: what to do where the thing did not come along on the way up.
    """
    # The turn on the way up does not matter: any tolerance is met.
    up = Phase(straight_up(height), position_tolerance=0.03, rotation_tolerance=math.inf, timeout=2.0)
    return (
        replace(up, gripper_open=False, retry=came),
        Phase(raised(place, clearance), False, position_tolerance=over, rotation_tolerance=0.05, timeout=4.0),
        Phase(place, False, position_tolerance=0.003, rotation_tolerance=0.05, timeout=2.0, least=0.02),
        Phase(place, dwell=0.3, timeout=0.4),
        up,
    )
