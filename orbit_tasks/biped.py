"""Rewards of a biped that walks: terms and weights, over those of robots on four feet.

They follow what Isaac Lab and mjlab learn a Unitree G1 with (Mittal et al., Orbit, 2023; Zakka et al., mjlab, 2026): a
fall costs, steps on one foot after the other earn, feet do not slide, and joints that carry no step stay near home.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import torch
from torch import Tensor

from orbit_core.dynamics.kinematics import KinematicTree
from orbit_core.envs import Environment
from orbit_core.interfaces import Robot, World
from orbit_core.mdp import common
from orbit_core.sensors import ContactSensor
from orbit_tasks import walking

# The contact sensor's name.
CONTACTS = "contacts"
# Seconds on one foot beyond which a step earns no more.
_LONGEST_STEP = 0.4
# Part of a joint's range, around its middle, within which its position costs nothing.
_SOFT_LIMIT = 0.9
# m/s: a robot that is commanded to go slower than this is to stand.
_LEAST_COMMAND = 0.1


class WalkingMemory(walking.SpeedLimited):
    """State of walking: looked up once in a new world."""

    foot_links: Tensor
    """(feet,) int64 among the links of the contact sensor."""
    other_links: Tensor
    """(k,) int64: links that are neither trunk nor feet."""
    still_joints: Tensor
    """(joints,) 1 for those that swing no leg forward, 0 for others."""

    def start(self, env: Environment) -> None:
        super().start(env)
        robot = common.robot_of(env.world)
        names = list(contacts_of(env.world).link_names)
        touching = [names.index(robot.spec.articulation.frame(foot).link) for foot in robot.spec.feet]
        others = [link for link in range(1, len(names)) if link not in touching]
        self.foot_links = torch.tensor(touching, device=env.device)
        self.other_links = torch.tensor(others, dtype=torch.int64, device=env.device)
        self.still_joints = still_joints(robot)


def contacts_of(world: World) -> ContactSensor:
    """The sensor of the robot's contacts."""
    sensor = world.sensors[CONTACTS]
    assert isinstance(sensor, ContactSensor)
    return sensor


def stride(env: Environment[Any, WalkingMemory]) -> Tensor:
    """(N,) seconds that the robot has stood on one foot with the other in the air; 0 if commanded to stand."""
    timer = contacts_of(env.world).timer()
    flying, touching = timer.air_time[:, env.state.foot_links], timer.contact_time[:, env.state.foot_links]
    standing = touching > 0.0
    lasted = torch.where(standing, touching, flying).amin(1).clamp_max(_LONGEST_STEP)
    return lasted * (standing.sum(1) == 1) * (env.commands["velocity"][:, :2].norm(dim=1) > _LEAST_COMMAND)


def slide(env: Environment[Any, WalkingMemory]) -> Tensor:
    """(N,) m/s along the ground of feet that touch it, summed."""
    robot = common.robot_of(env.world)
    velocities = torch.stack([robot.frame_velocity(foot)[:, :2] for foot in robot.spec.feet], 1)
    return (velocities.norm(dim=2) * contacts_of(env.world).in_contact()[:, env.state.foot_links]).sum(1)


def stray(env: Environment[Any, WalkingMemory]) -> Tensor:
    """(N,) rad, summed: how far joints that swing no leg are from home."""
    robot = common.robot_of(env.world)
    return ((robot.joint_positions - robot.home_positions) * env.state.still_joints).abs().sum(1)


def near_limits(env: Environment[Any, WalkingMemory]) -> Tensor:
    """(N,) rad, summed: how far joints are beyond nine tenths of their range."""
    robot = common.robot_of(env.world)
    low, high = robot.position_limits.unbind(1)
    reach = 0.5 * _SOFT_LIMIT * (high - low)
    return ((robot.joint_positions - 0.5 * (low + high)).abs() - reach).clamp_min(0.0).nan_to_num(0.0).sum(1)


def still_joints(robot: Robot) -> Tensor:
    """(joints,) 0 for joints that swing a leg forward, 1 for others.

    The former are those on the way to a foot whose axis, at home, is across the robot.
    """
    device = robot.home_positions.device
    tree = KinematicTree(robot.spec.articulation, device)
    root = torch.tensor([[0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0]], device=device)
    poses = tree.forward(root, robot.home_positions.view(1, -1))
    across = torch.stack([tree.jacobian(poses, foot)[0, 4].abs() for foot in robot.spec.feet]).amax(0)
    return (across < 0.7).float()


def suited(rewards: Any, feet: int) -> None:
    """Fit rewards of a walking task to the number of feet, where they are still the task's own.

    Robots on two feet get :data:`WEIGHTS`, and none of :data:`OF_MANY_FEET`; others none of :data:`OF_TWO_FEET`.

    Args:
        rewards: of Velocity-Flat, or derived from them.
        feet: how many the robot has.
    """
    own = type(rewards)()
    unwanted = OF_MANY_FEET if feet <= 2 else OF_TWO_FEET
    for name, weight in {**(WEIGHTS if feet <= 2 else {}), **dict.fromkeys(unwanted, 0.0)}.items():
        term = getattr(own, name, None)
        if term is not None and getattr(rewards, name) == term:
            setattr(rewards, name, replace(term, weight=weight) if weight else None)


# Of terms that robots on four feet have with other weights.
WEIGHTS: Mapping[str, float] = {
    "yaw_tracking": 1.0, "bouncing": -0.2, "tilt": -1.0, "effort": -2e-6, "action_rate": -0.02, "fall": -200.0,
}  # fmt: skip
# Terms of robots on two feet alone.
OF_TWO_FEET = ("stride", "slide", "stray", "near_limits")
# Terms of robots on more than two feet alone.
OF_MANY_FEET = ("flight", "bumps")
