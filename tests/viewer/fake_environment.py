"""An environment without physics: things that move on known paths, to be looked at."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import torch
from torch import Tensor

from orbit_core.interfaces import Marker, SceneLayout
from orbit_core.scene import (
    Box,
    Capsule,
    Cylinder,
    MarkerShape,
    MarkerSpec,
    ObjectSpec,
    Plane,
    Pose,
    Scene,
    Shape,
    Sphere,
    single_link,
)


def _thing(name: str, shape: Shape, pose: Pose) -> ObjectSpec:
    return ObjectSpec(name=name, articulation=single_link(name, shape, 1.0, np.eye(3)), pose=pose)


def scene_of_things() -> Scene:
    """Four shapes on a slab on a plane, and two markers."""
    things = (
        _thing("box", Shape(Box((0.1, 0.1, 0.1)), color=(0.85, 0.3, 0.25, 1.0)), Pose((0.3, 0.0, 0.2))),
        _thing("ball", Shape(Sphere(0.1), color=(0.2, 0.5, 0.85, 1.0)), Pose((0.0, 0.3, 0.2))),
        _thing("can", Shape(Cylinder(0.08, 0.12), color=(0.3, 0.7, 0.35, 1.0)), Pose((-0.3, 0.0, 0.22))),
        _thing("pill", Shape(Capsule(0.07, 0.1), color=(0.95, 0.75, 0.2, 1.0)), Pose((0.0, -0.3, 0.27))),
    )
    slab = Shape(Box((0.6, 0.6, 0.05)), Pose((0.0, 0.0, 0.05)), color=(0.75, 0.68, 0.58, 1.0))
    return Scene(
        objects=things,
        terrain=(Shape(Plane(), color=(0.35, 0.38, 0.42, 1.0)), slab),
        markers=(MarkerSpec("goal", size=0.2), MarkerSpec("way", MarkerShape.ARROW, 0.25, (0.9, 0.2, 0.7, 0.8))),
    )


class FakeMarker(Marker):
    def __init__(self, spec: MarkerSpec, pose: Tensor) -> None:
        self.spec = spec
        self._pose = pose

    @property
    def pose(self) -> Tensor:
        return self._pose

    def set_pose(self, pose: Tensor, env_ids: Tensor | None = None) -> None:
        self._pose[slice(None) if env_ids is None else env_ids] = pose


class FakeWorld:
    """Holds poses; the environment moves them."""

    def __init__(self, scene: Scene, num_envs: int) -> None:
        self.layout = SceneLayout.of(scene)
        self.start = torch.tensor(
            [(*entity.pose.position, *entity.pose.orientation) for entity in scene.entities], dtype=torch.float32
        )
        self.link_poses = self.start.repeat(num_envs, 1, 1)
        pose = torch.tensor([0.0, 0.0, 0.5, 1.0, 0.0, 0.0, 0.0]).repeat(num_envs, 1)
        self.markers: dict[str, Marker] = {spec.name: FakeMarker(spec, pose.clone()) for spec in scene.markers}
        self.sensors: dict[str, Any] = {}
        self.robots: dict[str, Any] = {}
        self.objects: dict[str, Any] = {}
        self.deformables: dict[str, Any] = {}


class FakeEnvironment:
    """Every thing circles the middle; environment i is i tenths of a turn ahead."""

    def __init__(self, num_envs: int = 4) -> None:
        self.world = FakeWorld(scene_of_things(), num_envs)
        self.num_envs = num_envs
        self.step_dt = 0.02
        self.resets = 0
        self.steps = 0
        self.actions: list[Tensor] = []

    def reset(self) -> Any:
        self.resets += 1
        self.steps = 0
        self._move()

    def step(self, action: Tensor) -> tuple[Any, Tensor, Tensor, Tensor, dict[str, Any]]:
        self.steps += 1
        self.actions.append(action)
        self._move()
        never = torch.zeros(self.num_envs, dtype=torch.bool)
        reward = torch.full((self.num_envs,), math.sin(self.steps * 0.05))
        return {}, reward, never, never, {}

    def _move(self) -> None:
        angle = 0.03 * self.steps + 2.0 * math.pi * 0.1 * torch.arange(self.num_envs)[:, None]
        x, y = self.world.start[:, 0], self.world.start[:, 1]
        self.world.link_poses[..., 0] = angle.cos() * x - angle.sin() * y
        self.world.link_poses[..., 1] = angle.sin() * x + angle.cos() * y


class FakeAgent:
    def act(self) -> Tensor:
        return torch.zeros(4, 1)
