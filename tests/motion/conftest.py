"""A robot without physics: its joints are wherever their targets last were."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import pytest
import torch
from torch import Tensor

from orbit_assets.catalogue import robot as catalogue_robot
from orbit_core.dynamics.kinematics import KinematicTree, PointJacobian
from orbit_core.interfaces import Robot
from orbit_core.preparation.merge import merge_fixed_links
from orbit_core.scene import RobotSpec


class KinematicRobot(Robot):
    """Follows position targets at once, and velocity targets over ``dt``; remembers efforts."""

    dt = 0.1

    def __init__(self, spec: RobotSpec, num_envs: int) -> None:
        self._spec, self.name = spec, spec.name
        self.link_names = spec.articulation.link_names
        self.joint_names = spec.articulation.joint_names
        self.tree = KinematicTree(spec.articulation)
        limits = [[j.lower_limit, j.upper_limit] for j in self.joints]
        self._limits = torch.tensor(limits, dtype=torch.float32)
        home = torch.zeros(len(self.joints))
        for pattern, value in spec.home.items():
            home[self.find_joints(pattern)] = value
        self._home = home.clamp(self._limits[:, 0], self._limits[:, 1])
        self.root = torch.tensor([0.3, -0.2, 0.1, 0.8, 0.0, 0.0, 0.6]).repeat(num_envs, 1)
        self.q = self._home.repeat(num_envs, 1)
        self.v = torch.zeros_like(self.q)
        self.efforts = torch.zeros_like(self.q)

    @property
    def spec(self) -> RobotSpec:
        return self._spec

    @property
    def root_pose(self) -> Tensor:
        return self.root

    @property
    def root_velocity(self) -> Tensor:
        return torch.zeros(len(self.root), 6)

    @property
    def link_poses(self) -> Tensor:
        return self.tree.forward(self.root, self.q)

    @property
    def link_velocities(self) -> Tensor:
        return self.tree.link_velocities(self.link_poses, self.root_velocity, self.v)

    @property
    def joint_positions(self) -> Tensor:
        return self.q

    @property
    def joint_velocities(self) -> Tensor:
        return self.v

    @property
    def joint_efforts(self) -> Tensor:
        return self.efforts

    def frame_pose(self, name: str) -> Tensor:
        return self.tree.frame_pose(self.link_poses, name)

    def frame_velocity(self, name: str) -> Tensor:
        return (self.tree.jacobian(self.link_poses, name) @ self.v.unsqueeze(-1)).squeeze(-1)

    def jacobian(self, frame: str, joints: Sequence[int] | None = None) -> Tensor:
        link = self.link_names.index(self.spec.articulation.frame(frame).link)
        columns = range(len(self.joints)) if joints is None else joints
        point = self.frame_pose(frame)[:, :3]
        return PointJacobian(self.spec.articulation, link, columns, self.q.device)(self.link_poses, point)

    @property
    def home_positions(self) -> Tensor:
        return self._home

    @property
    def position_limits(self) -> Tensor:
        return self._limits

    def set_root_pose(self, pose: Tensor, env_ids: Tensor | None = None) -> None:
        self.root[slice(None) if env_ids is None else env_ids] = pose

    def set_root_velocity(self, velocity: Tensor, env_ids: Tensor | None = None) -> None:
        raise NotImplementedError

    def set_joint_state(
        self,
        positions: Tensor | None = None,
        velocities: Tensor | None = None,
        joints: Sequence[int] | None = None,
        env_ids: Tensor | None = None,
    ) -> None:
        assert positions is not None
        self.q[slice(None) if env_ids is None else env_ids] = positions

    def set_position_targets(self, targets: Tensor, joints: Sequence[int] | None = None) -> None:
        self._assign(self.q, targets, joints)

    def set_velocity_targets(self, targets: Tensor, joints: Sequence[int] | None = None) -> None:
        columns = list(range(len(self.joints))) if joints is None else list(joints)
        self.q[:, columns] = self.q[:, columns] + self.dt * targets

    def set_effort_targets(self, efforts: Tensor, joints: Sequence[int] | None = None) -> None:
        self._assign(self.efforts, efforts, joints)

    def _assign(self, state: Tensor, values: Tensor, joints: Sequence[int] | None) -> None:
        state[:, slice(None) if joints is None else list(joints)] = values


@pytest.fixture
def kinematic_robot() -> Callable[..., KinematicRobot]:
    """(name in the catalogue, number of environments) -> a robot without physics, at home."""

    def make(name: str = "franka_panda", num_envs: int = 4) -> KinematicRobot:
        spec = catalogue_robot(name)
        return KinematicRobot(replace(spec, articulation=merge_fixed_links(spec.articulation)), num_envs)

    return make
