"""What tasks, nodes and learning code see of a world, simulated or real."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from typing import Any

import torch
from torch import Tensor

from orbit_core.interfaces.sensor import Sensor
from orbit_core.scene import Entity, Joint, MarkerSpec, RobotSpec


class Object(ABC):
    """An articulation in N environments; a rigid object is one with a single link.

    Poses are (..., 7): position, quaternion (w, x, y, z); velocities (..., 6): linear of the frame's origin, then
    angular, world axes. Tensors read are valid until the next step or write: clone what you keep.
    """

    name: str
    link_names: tuple[str, ...]
    joint_names: tuple[str, ...]

    @property
    @abstractmethod
    def spec(self) -> Entity:
        """What it was made from."""

    # Reading

    @property
    @abstractmethod
    def root_pose(self) -> Tensor:
        """(N, 7)"""

    @property
    @abstractmethod
    def root_velocity(self) -> Tensor:
        """(N, 6)"""

    @property
    @abstractmethod
    def link_poses(self) -> Tensor:
        """(N, links, 7)"""

    @property
    @abstractmethod
    def link_velocities(self) -> Tensor:
        """(N, links, 6)"""

    @property
    @abstractmethod
    def joint_positions(self) -> Tensor:
        """(N, joints)"""

    @property
    @abstractmethod
    def joint_velocities(self) -> Tensor:
        """(N, joints)"""

    @property
    @abstractmethod
    def joint_efforts(self) -> Tensor:
        """(N, joints) applied in the last physics step."""

    @abstractmethod
    def frame_pose(self, name: str) -> Tensor:
        """(N, 7) of a link or named frame."""

    @abstractmethod
    def frame_velocity(self, name: str) -> Tensor:
        """(N, 6) of a link or named frame."""

    @abstractmethod
    def jacobian(self, frame: str, joints: Sequence[int] | None = None) -> Tensor:
        """(N, 6, k) geometric Jacobian of a link or named frame: linear, angular; world axes; columns are joints."""

    # Looking up

    @abstractmethod
    def find_joints(self, *patterns: str) -> list[int]:
        """Indices of the joints whose names a regular expression matches in full, in joint order."""

    @abstractmethod
    def find_links(self, *patterns: str) -> list[int]:
        """Indices of the links whose names a regular expression matches in full, in link order."""

    @property
    @abstractmethod
    def joints(self) -> tuple[Joint, ...]:
        """The movable joints' descriptions."""

    @property
    @abstractmethod
    def home_positions(self) -> Tensor:
        """(joints,) positions at reset."""

    @property
    @abstractmethod
    def position_limits(self) -> Tensor:
        """(joints, 2) lower, upper."""

    # Writing state

    @abstractmethod
    def set_root_pose(self, pose: Tensor, env_ids: Tensor | None = None) -> None:
        """(n, 7)"""

    @abstractmethod
    def set_root_velocity(self, velocity: Tensor, env_ids: Tensor | None = None) -> None:
        """(n, 6)"""

    @abstractmethod
    def set_joint_state(
        self,
        positions: Tensor | None = None,
        velocities: Tensor | None = None,
        joints: Sequence[int] | None = None,
        env_ids: Tensor | None = None,
    ) -> None:
        """(n, k) each; position targets follow the positions."""


class Robot(Object):
    """An articulation with actuator groups that take commands."""

    @property
    @abstractmethod
    def spec(self) -> RobotSpec:
        """What it was made from."""

    @abstractmethod
    def set_position_targets(self, targets: Tensor, joints: Sequence[int] | None = None) -> None:
        """(N, k) rad or m."""

    @abstractmethod
    def set_velocity_targets(self, targets: Tensor, joints: Sequence[int] | None = None) -> None:
        """(N, k) rad/s or m/s."""

    @abstractmethod
    def set_effort_targets(self, efforts: Tensor, joints: Sequence[int] | None = None) -> None:
        """(N, k) N m or N, added to the actuators' PD law."""


class Marker(ABC):
    """Something drawn for people, with no physics."""

    spec: MarkerSpec

    @property
    @abstractmethod
    def pose(self) -> Tensor:
        """(N, 7)"""

    @abstractmethod
    def set_pose(self, pose: Tensor, env_ids: Tensor | None = None) -> None:
        """(n, 7)"""


class World(ABC):
    """N environments stepped together."""

    num_envs: int
    device: torch.device
    physics_dt: float
    robots: Mapping[str, Robot]
    objects: Mapping[str, Object]
    sensors: Mapping[str, Sensor]
    markers: Mapping[str, Marker]

    @abstractmethod
    def step(self, steps: int = 1) -> None:
        """Advance by that many physics steps with commands held; sensors measure when they are due."""

    @abstractmethod
    def reset(self, env_ids: Tensor | None = None) -> None:
        """Return environments to the scene's initial state, sensors, actuators and random streams included."""

    @abstractmethod
    def save_state(self) -> Any:
        """Everything that the continuation depends on."""

    @abstractmethod
    def load_state(self, state: Any) -> None:
        """Return to a saved state."""

    @abstractmethod
    def close(self) -> None:
        """Free what the world holds; idempotent."""
