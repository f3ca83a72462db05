"""A world at one moment, for plans that take longer than a step: what moves on meanwhile does not change it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Protocol

import torch
from torch import Tensor

from orbit_core.interfaces import Object, Robot, World
from orbit_core.scene import Entity, RobotSpec, Scene


class PlacedObject(Protocol):
    """What plans read of an object: N environments, shapes as :class:`orbit_core.interfaces.Object` has them."""

    @property
    def spec(self) -> Entity:
        """Specification that the entity was made from."""
        ...

    @property
    def root_pose(self) -> Tensor:
        """(N, 7)"""
        ...

    @property
    def link_poses(self) -> Tensor:
        """(N, links, 7)"""
        ...


class PlacedRobot(Protocol):
    """What plans read of a robot."""

    name: str
    joint_names: tuple[str, ...]
    link_names: tuple[str, ...]

    @property
    def spec(self) -> RobotSpec:
        """Specification that the entity was made from."""
        ...

    @property
    def root_pose(self) -> Tensor:
        """(N, 7)"""
        ...

    @property
    def joint_positions(self) -> Tensor:
        """(N, joints)"""
        ...

    @property
    def home_positions(self) -> Tensor:
        """(joints,) positions at reset."""
        ...

    @property
    def position_limits(self) -> Tensor:
        """(joints, 2) lower, upper."""
        ...


class PlacedWorld(Protocol):
    """What plans read of a world."""

    scene: Scene
    num_envs: int
    device: torch.device

    @property
    def objects(self) -> Mapping[str, PlacedObject]:
        """By name."""
        ...


@dataclass(eq=False)
class StillObject:
    """A :class:`PlacedObject` in one environment."""

    spec: Entity
    root_pose: Tensor
    link_poses: Tensor


@dataclass(eq=False)
class StillRobot:
    """A :class:`PlacedRobot` in one environment."""

    name: str
    joint_names: tuple[str, ...]
    link_names: tuple[str, ...]
    spec: RobotSpec
    root_pose: Tensor
    joint_positions: Tensor
    home_positions: Tensor
    position_limits: Tensor


@dataclass(eq=False)
class StillWorld:
    """A :class:`PlacedWorld` of one environment, and one of its robots."""

    scene: Scene
    num_envs: int
    device: torch.device
    objects: Mapping[str, PlacedObject]
    robot: StillRobot

    @staticmethod
    def of(world: World, robot: Robot, env: int = 0) -> StillWorld:
        """Return a copy of one environment as it now is, which any thread may read."""
        objects = {name: _still_object(thing, env) for name, thing in world.objects.items()}
        copied = StillRobot(
            robot.name,
            robot.joint_names,
            robot.link_names,
            robot.spec,
            *(part[env : env + 1].clone() for part in (robot.root_pose, robot.joint_positions)),
            *(part.clone() for part in (robot.home_positions, robot.position_limits)),
        )
        return StillWorld(world.scene, 1, world.device, objects, copied)


def _still_object(thing: Object, env: int) -> StillObject:
    poses = (part[env : env + 1].clone() for part in (thing.root_pose, thing.link_poses))
    return StillObject(thing.spec, *poses)
