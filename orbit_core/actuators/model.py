"""Base of actuator models: efforts from targets and measured joint state, for many joints of all environments at once.

Packages add models of their own through the entry-point group ``orbit.actuators``; an entry point is named as the class
of the groups that the model drives, and its value is the model's class::

    [project.entry-points."orbit.actuators"]
    SpringMotor = "my_package.spring_motor:SpringMotorModel"
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Hashable, Sequence
from dataclasses import dataclass
from typing import Any

import torch
from torch import Tensor

from orbit_core.dynamics.indexing import columns_of, write_rows
from orbit_core.interfaces import SceneLayout


@dataclass(frozen=True)
class ActuatorContext:
    """Joints and settings that a model is built for."""

    joints: tuple[int, ...]
    """Indices (k,) of the model's joints in the scene."""
    groups: tuple[Any, ...]
    """The actuator group of each of them, an :class:`~orbit_core.scene.ActuatorConfig` of the model's class."""
    layout: SceneLayout
    """Of the scene: names, types and parameters of all joints."""
    num_envs: int
    """N."""
    device: torch.device

    @property
    def physics_dt(self) -> float:
        """Seconds between two evaluations."""
        return self.layout.scene.physics_dt

    @property
    def effort_limits(self) -> Tensor:
        """(k,) N m or N, as groups or the articulation say."""
        limits = self.layout.joint_parameters.effort_limit[list(self.joints)]
        return torch.as_tensor(limits, dtype=torch.float32, device=self.device)

    def values(self, name: str) -> Tensor:
        """(N, k) a number that the groups hold under that field, as memory that may be written per environment."""
        numbers = [float(getattr(group, name)) for group in self.groups]
        return torch.tensor(numbers, device=self.device).repeat(self.num_envs, 1)


class ActuatorModel(ABC):
    """Computes the efforts of k joints in N environments before each physics step.

    A subclass overrides :meth:`efforts`. It keeps to what a captured step may do: tensor operations, no look at a
    tensor's values, and what lasts from step to step in :attr:`memory`, written in place.

    Args:
        context: the joints, their groups, and the scene.
    """

    def __init__(self, context: ActuatorContext) -> None:
        self.joints = list(context.joints)
        self.columns = columns_of(self.joints, context.device)
        self.memory: dict[str, Tensor] = {}
        """(N, ...) tensors that the model remembers, by name: part of snapshots, set to :meth:`fresh` by resets."""
        self.gains: tuple[Tensor, Tensor] | None = None
        """(N, k) stiffness and damping, where the model has such gains: events scale them, and they outlast resets."""

    @abstractmethod
    def efforts(self, position: Tensor, velocity: Tensor, targets: Sequence[Tensor]) -> Tensor:
        """Compute the efforts (N, k) of one physics step, N m or N.

        Args:
            position: (N, k) measured, rad or m.
            velocity: (N, k) measured, rad/s or m/s.
            targets: position, velocity and effort targets, (N, k) each.
        """

    @property
    def temperatures(self) -> Tensor | None:
        """(N, k) degrees Celsius of the motors; None where the model knows of none."""
        return None

    def fresh(self, name: str) -> Tensor | float:
        """Return what a part of the memory holds when an episode begins."""
        return 0.0

    def reset(self, env_ids: Tensor | None) -> None:
        """Forget the past of some environments, by index or mask."""
        for name, value in self.memory.items():
            write_rows(value, self.fresh(name), env_ids)

    @classmethod
    def shared_by(cls, group: Any) -> Hashable:
        """Return a key: groups that agree in it share one model. All groups of a class do unless this is overridden."""
        return None
