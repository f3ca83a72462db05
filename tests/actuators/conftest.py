"""An engine of independent pendulums, exact enough to compare actuators on it."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
import torch
from torch import Tensor

from orbit_core.interfaces import Approximation, BuiltModel, Engine, SceneLayout
from orbit_core.scene import ActuatorConfig, Articulation, Joint, JointType, Link, RobotSpec, Scene

MASS_LENGTH = 0.5
"""kg m of every pendulum, whose inertia is 1 kg m^2."""


class PendulumEngine(Engine):
    """Every joint is a pendulum of unit inertia; drives are integrated implicitly, efforts explicitly."""

    def __init__(self, layout: SceneLayout, num_envs: int) -> None:
        super().__init__(layout, num_envs, torch.device("cpu"))
        self.q = torch.zeros(num_envs, len(layout.joints))
        self.v = torch.zeros_like(self.q)
        self.applied = torch.zeros_like(self.q)
        parameters = layout.joint_parameters
        self.stiffness = torch.as_tensor(parameters.drive_stiffness).float().repeat(num_envs, 1)
        self.damping = torch.as_tensor(parameters.drive_damping).float().repeat(num_envs, 1)

    def step(self, steps: int) -> None:
        dt = self.layout.scene.physics_dt
        for _ in range(steps):
            gravity = -9.81 * MASS_LENGTH * torch.sin(self.q)
            spring = self.stiffness * (self.position_targets - self.q - dt * self.v) + self.damping * (
                self.velocity_targets - self.v
            )
            inertia = 1.0 + dt * self.damping + dt * dt * self.stiffness
            self.v = self.v + dt * (gravity + spring + self.efforts) / inertia
            self.q = self.q + dt * self.v
            self.applied = self.efforts.clone()

    @property
    def joint_positions(self) -> Tensor:
        return self.q

    @property
    def joint_velocities(self) -> Tensor:
        return self.v

    @property
    def joint_efforts(self) -> Tensor:
        return self.applied

    def built_model(self) -> tuple[BuiltModel, ...]:
        raise NotImplementedError

    @property
    def link_poses(self) -> Tensor:
        raise NotImplementedError

    @property
    def link_velocities(self) -> Tensor:
        raise NotImplementedError

    def write_joint_state(
        self, joints: Tensor, positions: Tensor | None, velocities: Tensor | None, env_ids: Tensor | None = None
    ) -> None:
        raise NotImplementedError

    def write_root_state(
        self, entity: int, pose: Tensor | None, velocity: Tensor | None, env_ids: Tensor | None = None
    ) -> None:
        raise NotImplementedError

    def set_drive_gains(
        self, joints: Tensor, stiffness: Tensor, damping: Tensor, env_ids: Tensor | None = None
    ) -> None:
        rows = slice(None) if env_ids is None else env_ids[:, None]
        self.stiffness[rows, joints] = stiffness
        self.damping[rows, joints] = damping

    def reset(self, env_ids: Tensor | None = None) -> None:
        rows = slice(None) if env_ids is None else env_ids
        for tensor in (self.q, self.v, self.position_targets, self.velocity_targets, self.efforts):
            tensor[rows] = 0.0

    def save_state(self) -> Any:
        return [t.clone() for t in (self.q, self.v, self.position_targets, self.velocity_targets, self.efforts)]

    def load_state(self, state: Any) -> None:
        own = (self.q, self.v, self.position_targets, self.velocity_targets, self.efforts)
        for tensor, saved in zip(own, state, strict=True):
            tensor.copy_(saved)

    @property
    def build_report(self) -> tuple[Approximation, ...]:
        return ()

    @property
    def native(self) -> Any:
        return None


def _pendulums(actuators: tuple[ActuatorConfig, ...], num_envs: int = 2, dt: float = 0.005) -> PendulumEngine:
    names = ("a", "b", "c")
    links = tuple(Link(name, 1.0, inertia=np.eye(3)) for name in ("base", *names))
    joints = tuple(
        Joint(f"joint_{name}", JointType.CONTINUOUS, "base", name, effort_limit=8.0, velocity_limit=20.0)
        for name in names
    )
    robot = RobotSpec(
        name="robot", articulation=Articulation("robot", links, joints), fixed_base=True, actuators=actuators
    )
    return PendulumEngine(SceneLayout.of(Scene(robots=(robot,), physics_dt=dt)), num_envs)


@pytest.fixture
def pendulums() -> Callable[..., PendulumEngine]:
    """(actuator groups, num_envs, dt) -> an engine with joints joint_a, joint_b, joint_c, effort limit 8."""
    return _pendulums
