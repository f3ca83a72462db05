"""Copy of a world at one moment, for plans that take longer than a step while the world moves on."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Protocol

import torch
from torch import Tensor

from orbit_core.interfaces import Object, Robot, World
from orbit_core.scene import Entity, RobotSpec, Scene


class PlacedObject(Protocol):
    """Interface of an object that planning reads, shaped like :class:`orbit_core.interfaces.Object`."""

    @property
    def spec(self) -> Entity:
        """Specification that the entity was made from."""
        ...

    @property
    def root_pose(self) -> Tensor:
        """Pose (N, 7) in the environment's frame."""
        ...

    @property
    def link_poses(self) -> Tensor:
        """Poses (N, links, 7) in the environment's frame."""
        ...


class PlacedRobot(Protocol):
    """Interface of a robot that planning reads."""

    name: str
    joint_names: tuple[str, ...]
    link_names: tuple[str, ...]

    @property
    def spec(self) -> RobotSpec:
        """Specification that the entity was made from."""
        ...

    @property
    def root_pose(self) -> Tensor:
        """Pose (N, 7) in the environment's frame."""
        ...

    @property
    def joint_positions(self) -> Tensor:
        """Joint positions (N, joints) in rad or m."""
        ...

    @property
    def home_positions(self) -> Tensor:
        """Joint positions (joints,) at reset."""
        ...

    @property
    def position_limits(self) -> Tensor:
        """Lower and upper limits (joints, 2)."""
        ...


class PlacedWorld(Protocol):
    """Interface of a world that planning reads."""

    scene: Scene
    num_envs: int
    device: torch.device

    @property
    def objects(self) -> Mapping[str, PlacedObject]:
        """Objects by name."""
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
