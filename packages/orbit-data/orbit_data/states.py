"""State of a world as one row of numbers, the same on every engine, and the memory of a task."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING

import torch
from torch import Tensor

from orbit_core.dynamics.indexing import write_rows
from orbit_core.envs.captured_step import remembered
from orbit_core.interfaces import ConfigurationError, Object, World

if TYPE_CHECKING:
    from orbit_core.envs.environment import Environment

_MARKERS = "markers"


@dataclass(frozen=True)
class StatePart:
    """Part of a state's row, read from a world and set in it."""

    name: str
    """Path of the value, such as entity and quantity."""
    shape: tuple[int, ...]
    """Shape of one environment's value."""
    read: Callable[[], Tensor]
    """Function that returns the present value (N, *shape)."""

    @property
    def size(self) -> int:
        """Number of components."""
        return int(torch.Size(self.shape).numel())


class WorldStates:
    """States (n, S) of a world in SI units, in the environment's frame.

    A row holds the root's pose (7) and velocity (6) and the positions and velocities of the joints of each robot and
    object, then the positions and velocities of the particles of each deformable. Fixed bases have no velocity, single
    links no joints.

    Args:
        world: world whose states are read and set.
    """

    def __init__(self, world: World) -> None:
        self._world = world
        self._bodies: dict[str, Object] = {**world.robots, **world.objects}
        self.parts = tuple(self._parts())
        """Parts in the order of the row."""
        self.size = sum(part.size for part in self.parts)
        """Numbers S of a row."""

    def read(self) -> Tensor:
        """Return the states (N, S) in a new tensor."""
        return torch.cat([part.read().flatten(1) for part in self.parts], dim=1)

    def write(self, states: Tensor, env_ids: Tensor) -> None:
        """Set states (n, S) of some environments (n,); targets of joints follow.

        Raises:
            ConfigurationError: the rows are of another world's size.
            UnsupportedCapabilityError: the engine cannot set particles.
        """
        if states.shape[1] != self.size:
            raise ConfigurationError(
                f"a recorded state has {states.shape[1]} numbers and this world's {self.size}: the recording is of "
                "another robot or other objects"
            )
        columns = states.split_with_sizes([part.size for part in self.parts], dim=1)
        values = {p.name: c.unflatten(1, p.shape) for p, c in zip(self.parts, columns, strict=True)}
        for name, body in self._bodies.items():
            body.set_root_pose(values[f"{name}/root_pose"], env_ids)
            if f"{name}/root_velocity" in values:
                body.set_root_velocity(values[f"{name}/root_velocity"], env_ids)
            if f"{name}/joint_positions" in values:
                body.set_joint_state(
                    values[f"{name}/joint_positions"], values[f"{name}/joint_velocities"], env_ids=env_ids
                )
        for name, body in self._world.deformables.items():
            body.set_state(values[f"{name}/positions"], values[f"{name}/velocities"], env_ids)

    def _parts(self) -> Iterator[StatePart]:
        for name, body in self._bodies.items():
            # Default arguments bind the bodies now: the readers are called after the loop has gone on.
            yield StatePart(f"{name}/root_pose", (7,), lambda body=body: body.root_pose)
            if not body.spec.fixed_base:
                yield StatePart(f"{name}/root_velocity", (6,), lambda body=body: body.root_velocity)
            if count := len(body.joint_names):
                yield StatePart(f"{name}/joint_positions", (count,), lambda body=body: body.joint_positions)
                yield StatePart(f"{name}/joint_velocities", (count,), lambda body=body: body.joint_velocities)
        for name, body in self._world.deformables.items():
            shape = tuple(body.positions.shape[1:])
            yield StatePart(f"{name}/positions", shape, lambda body=body: body.positions)
            yield StatePart(f"{name}/velocities", shape, lambda body=body: body.velocities)


class TaskMemory:
    """Memory of a task, its agent's nodes and the markers, tensors (N, ...) by name; most of it is goals."""

    def __init__(self, environment: Environment) -> None:
        found = remembered(environment)
        rows = {_plain(name): value for name, value in found.items() if value.shape[:1] == (environment.num_envs,)}
        self._tensors = {name: value for name, value in rows.items() if value[0].numel()}
        self._world = environment.world

    def read(self) -> dict[str, Tensor]:
        """Return the tensors themselves, which later steps change: copy them to keep them."""
        markers = {_MARKERS: self._world.marker_poses} if self._world.markers else {}
        return {**self._tensors, **markers}

    def write(self, values: Mapping[str, Tensor], env_ids: Tensor) -> None:
        """Set rows (n, ...) of some environments (n,); names and shapes that this task does not have are ignored."""
        values = {_renamed(name): value for name, value in values.items()}
        for name, tensor in self._tensors.items():
            if name in values and values[name][0].numel() == tensor[0].numel():
                write_rows(tensor, values[name].to(tensor.dtype).view(-1, *tensor.shape[1:]), env_ids)
        if _MARKERS in values and values[_MARKERS].shape[1:] == self._world.marker_poses.shape[1:]:
            for marker, pose in zip(self._world.markers.values(), values[_MARKERS].unbind(1), strict=True):
                marker.set_pose(pose, env_ids)
        self._world.clock.touch()  # cached observations depend on the memory too


# Names of memory that recordings from before commands were terms have.
_RENAMED = {"VelocityFlat.command": "VelocityFlat.velocity"}


def _renamed(name: str) -> str:
    return _RENAMED.get(name, name)


def _plain(name: str) -> str:
    """Convert a path of brackets and quotes to words between dots, which any file format can hold."""
    return ".".join(re.findall(r"[\w ]+", name)).replace(" ", "_")
