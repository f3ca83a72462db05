"""An engine whose environments are divided over worker processes, each with an engine of some of them.

What an engine does for one environment must not depend on the others of its process: the results are then those of one
process, bit for bit. A step is one message to each worker and one back. State and commands lie in shared memory: after
a step the workers write there what was read since the start, and nothing else.
"""

from __future__ import annotations

import os
import weakref
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, fields, is_dataclass
from pathlib import Path
from typing import Any, Protocol

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor

from orbit_core.interfaces import (
    Approximation,
    BuiltModel,
    ConfigurationError,
    Engine,
    FailedEnvironmentsError,
    RayHits,
    SceneLayout,
)
from orbit_core.plugin_kit.scratch import ScratchFolder
from orbit_core.plugin_kit.shared_arrays import SHARED_FOLDER, Shapes, shared_arrays
from orbit_core.plugin_kit.workers import Failure, Range, Workers

_COMMANDS = ("position_targets", "velocity_targets", "efforts")
_CPU = torch.device("cpu")


class EngineClass(Protocol):
    """Class of an engine on the CPU, found by its name in the worker."""

    def __call__(self, layout: SceneLayout, num_envs: int, device: torch.device, config: Any, /) -> Engine:
        """Make an engine."""
        ...


def _shapes(layout: SceneLayout, num_envs: int) -> Shapes:
    """Return the shapes of commands and state."""
    joints = (num_envs, len(layout.joints))
    return dict.fromkeys((*_COMMANDS, "joint_positions", "joint_velocities", "joint_efforts"), joints) | {
        "link_poses": (num_envs, len(layout.links), 7),
        "link_velocities": (num_envs, len(layout.links), 6),
        "contact_forces": (num_envs, len(layout.contact_queries), 3),
        "joint_wrenches": (num_envs, len(layout.wrench_links), 6),
    }


# In a worker ----------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Share:
    """One worker's environments, and the memory in which it shares their state."""

    kind: EngineClass
    """Class of the engine."""
    layout: SceneLayout
    """The scene."""
    config: Any
    """Settings of the backend, as they are in one process."""
    num_envs: int
    """Number of environments of all workers."""
    rows: Range
    """First environment, and one past the last."""
    memory: Path
    """File of the shared arrays."""

    def __call__(self, report: Callable[[int], None]) -> HostedEngine:
        """Build the engine in its worker, which has one core."""
        torch.set_num_threads(1)
        start, stop = self.rows
        arrays = shared_arrays(_shapes(self.layout, self.num_envs), self.memory)
        shared = {name: torch.from_numpy(array[start:stop]) for name, array in arrays.items()}
        return HostedEngine(self.kind(self.layout, stop - start, _CPU, self.config), shared)


class HostedEngine:
    """An engine in a worker, which reads its commands from shared memory and writes its state there."""

    def __init__(self, engine: Engine, shared: dict[str, Tensor]) -> None:
        self._engine, self._shared = engine, shared
        self._published: tuple[str, ...] = ()

    def step(self, steps: int, raises_divergence: bool) -> None:
        """Take the commands, advance, and publish."""
        for name in _COMMANDS:
            getattr(self._engine, name).copy_(self._shared[name])
        self._engine.raises_divergence = raises_divergence
        try:
            self._engine.step(steps)
        finally:
            self.publish(self._published)

    def publish(self, names: tuple[str, ...]) -> None:
        """Write some of the state to shared memory, now and after each step."""
        self._published = names
        for name in names:
            self._shared[name].copy_(getattr(self._engine, name))

    def call(self, method: str, fixed: tuple[Any, ...], rowwise: tuple[Any, ...], env_ids: Any) -> Any:
        """Call a method of the engine, whose last argument is ``env_ids``, with arrays in the place of tensors."""
        arguments = map(_tensor, (*fixed, *rowwise, env_ids))
        result = getattr(self._engine, method)(*arguments)
        return {f.name: getattr(result, f.name).numpy() for f in fields(result)} if is_dataclass(result) else result

    def built(self) -> tuple[tuple[Approximation, ...], tuple[BuiltModel, ...]]:
        """Return the build report and the model."""
        return self._engine.build_report, self._engine.built_model()

    def save_state(self) -> Any:
        """Return the engine's snapshot, which must survive pickling."""
        return self._engine.save_state()

    def load_state(self, state: Any) -> None:
        """Return to a snapshot."""
        self._engine.load_state(state)

    def close(self) -> None:
        """Free the engine's resources."""
        self._engine.close()


def _tensor(value: Any) -> Any:
    return torch.from_numpy(value) if isinstance(value, np.ndarray) else value


# In the program -------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class SplitSnapshot:
    """Snapshots of the workers' engines, and the commands."""

    ranges: tuple[Range, ...]
    """Environments of each."""
    states: tuple[Any, ...]
    """Snapshots, as the workers' engines gave them."""
    commands: dict[str, Tensor] = field(repr=False)
    """Targets and efforts."""


class SplitEngine(Engine):
    """Engine that has its environments stepped by workers; for engines without deformables and without variants.

    A failure in one worker's environments leaves the others stepped. Errors of writes come with the next read or step,
    those of parameters at once.
    """

    def __init__(
        self, kind: EngineClass, layout: SceneLayout, num_envs: int, config: Any, ranges: Sequence[Range]
    ) -> None:
        """Start the workers and build their engines.

        Args:
            kind: class of the engine, by which each worker makes its own.
            layout: the scene.
            num_envs: number of environments.
            config: settings of the backend, which each worker's engine is given.
            ranges: environments of each worker.
        """
        super().__init__(layout, num_envs, _CPU)
        self.config = config
        """Settings of the backend."""
        self.ranges = tuple(ranges)
        """First environment, and one past the last, of each worker."""
        with ScratchFolder(f"orbit-workers-{os.getpid()}-", SHARED_FOLDER) as folder:
            memory = folder / "state"
            arrays = shared_arrays(_shapes(layout, num_envs), memory)
            shares = [Share(kind, layout, config, num_envs, own, memory) for own in self.ranges]
            self._workers = Workers(self.ranges, shares, lambda count: None)
        self._finalizer = weakref.finalize(self, _release, self._workers, os.getpid())
        self._tensors = {name: torch.from_numpy(array) for name, array in arrays.items()}
        self._home = self.position_targets[:1].clone()
        for name in _COMMANDS:
            self._tensors[name].copy_(getattr(self, name))
            setattr(self, name, self._tensors[name])
        # State that workers publish after each step: what was read once. Workers that were written to since.
        self._published: tuple[str, ...] = ()
        self._behind: set[int] = set()
        self._built: tuple[tuple[Approximation, ...], tuple[BuiltModel, ...]] = self._workers.call(
            "built", numbers=[0]
        )[0]

    # Time ------------------------------------------------------------------------------------------------------------

    def step(self, steps: int) -> None:
        self._behind.clear()
        failed: dict[str, list[int]] = {}
        replies = self._workers.gather("step", steps, self.raises_divergence)
        for (start, _), reply in zip(self.ranges, replies, strict=True):
            if isinstance(reply, Failure):
                if not isinstance(reply.error, FailedEnvironmentsError):
                    raise reply.error
                failed.setdefault(reply.error.what, []).extend(start + row for row in reply.error.environments)
        for what, environments in failed.items():  # of several kinds of failure the first
            raise FailedEnvironmentsError(environments, what)

    # State -----------------------------------------------------------------------------------------------------------

    @property
    def joint_positions(self) -> Tensor:
        return self._read("joint_positions")

    @property
    def joint_velocities(self) -> Tensor:
        return self._read("joint_velocities")

    @property
    def joint_efforts(self) -> Tensor:
        return self._read("joint_efforts")

    @property
    def link_poses(self) -> Tensor:
        return self._read("link_poses")

    @property
    def link_velocities(self) -> Tensor:
        return self._read("link_velocities")

    @property
    def contact_forces(self) -> Tensor:
        return self._read("contact_forces")

    @property
    def joint_wrenches(self) -> Tensor:
        return self._read("joint_wrenches")

    def _read(self, name: str) -> Tensor:
        if name not in self._published:
            self._published += (name,)
            self._behind.update(range(len(self.ranges)))
        if self._behind:
            self._workers.call("publish", self._published, numbers=sorted(self._behind))
            self._behind.clear()
        return self._tensors[name]

    def write_joint_state(
        self, joints: Tensor, positions: Tensor | None, velocities: Tensor | None, env_ids: Tensor | None = None
    ) -> None:
        self._post("write_joint_state", env_ids, (joints,), positions, velocities)

    def write_root_state(
        self, entity: int, pose: Tensor | None, velocity: Tensor | None, env_ids: Tensor | None = None
    ) -> None:
        self._post("write_root_state", env_ids, (entity,), pose, velocity)

    def reset(self, env_ids: Tensor | None = None) -> None:
        rows = slice(None) if env_ids is None else env_ids
        self.position_targets[rows] = self._home
        self.velocity_targets[rows] = 0.0
        self.efforts[rows] = 0.0
        self._post("reset", env_ids, ())

    # Measurements ----------------------------------------------------------------------------------------------------

    def cast_rays(
        self, origins: Tensor, directions: Tensor, max_distance: float, env_ids: Tensor | None = None
    ) -> RayHits:
        return self.cast_rays_past(origins, directions, max_distance, range(0), env_ids)

    def cast_rays_past(
        self, origins: Tensor, directions: Tensor, max_distance: float, links: range, env_ids: Tensor | None = None
    ) -> RayHits:
        rows = np.arange(self.num_envs) if env_ids is None else env_ids.numpy()
        shape = origins.shape[:2]
        hits = RayHits(torch.empty(shape), torch.empty(*shape, 3), torch.empty(shape, dtype=torch.int64))
        calls: dict[int, tuple[Any, ...]] = {}
        places: list[npt.NDArray[np.int64]] = []
        for number, (start, stop) in enumerate(self.ranges):
            here = np.flatnonzero((rows >= start) & (rows < stop))
            if len(here):
                rays = origins.numpy()[here], directions.numpy()[here]
                calls[number] = "cast_rays_past", (*rays, max_distance, links), (), rows[here] - start
                places.append(here)
        for here, found in zip(places, self._workers.call_each("call", calls), strict=True):
            for name, values in found.items():
                getattr(hits, name)[torch.from_numpy(here)] = torch.from_numpy(values)
        return hits

    # Parameters per environment --------------------------------------------------------------------------------------

    def set_wrenches(self, links: Tensor, wrenches: Tensor, env_ids: Tensor | None = None) -> None:
        self._post("set_wrenches", env_ids, (links,), wrenches)

    def set_masses(self, links: Tensor, masses: Tensor, env_ids: Tensor | None = None) -> None:
        self._set("set_masses", env_ids, (links,), masses)

    def set_centers_of_mass(self, links: Tensor, centers: Tensor, env_ids: Tensor | None = None) -> None:
        self._set("set_centers_of_mass", env_ids, (links,), centers)

    def set_friction(self, links: Tensor, coefficients: Tensor, env_ids: Tensor | None = None) -> None:
        self._set("set_friction", env_ids, (links,), coefficients)

    def set_drive_gains(
        self, joints: Tensor, stiffness: Tensor, damping: Tensor, env_ids: Tensor | None = None
    ) -> None:
        self._set("set_drive_gains", env_ids, (joints,), stiffness, damping)

    def set_joint_parameters(
        self,
        joints: Tensor,
        damping: Tensor | None,
        friction: Tensor | None,
        armature: Tensor | None,
        stiffness: Tensor | None = None,
        env_ids: Tensor | None = None,
    ) -> None:
        self._set("set_joint_parameters", env_ids, (joints,), damping, friction, armature, stiffness)

    def set_joint_limits(self, joints: Tensor, lower: Tensor, upper: Tensor, env_ids: Tensor | None = None) -> None:
        self._set("set_joint_limits", env_ids, (joints,), lower, upper)

    def set_gravity(self, gravity: Tensor, env_ids: Tensor | None = None) -> None:
        self._set("set_gravity", env_ids, (), gravity)

    # Calls -----------------------------------------------------------------------------------------------------------

    def _post(self, method: str, env_ids: Tensor | None, fixed: tuple[Any, ...], *rowwise: Tensor | None) -> None:
        """Have a method done, ahead of the next step or read, without waiting."""
        for number, arguments in self._parts(method, env_ids, fixed, rowwise):
            self._workers.post(number, "call", *arguments)
            self._behind.add(number)

    def _set(self, method: str, env_ids: Tensor | None, fixed: tuple[Any, ...], *rowwise: Tensor | None) -> None:
        """Have a method done, and raise what it refuses."""
        calls = dict(self._parts(method, env_ids, fixed, rowwise))
        self._behind.update(calls)
        self._workers.call_each("call", calls)

    def _parts(
        self, method: str, env_ids: Tensor | None, fixed: tuple[Any, ...], rowwise: tuple[Tensor | None, ...]
    ) -> Iterator[tuple[int, tuple[Any, ...]]]:
        """Yield the arguments of :meth:`HostedEngine.call` for each worker that has some of the environments.

        Args:
            method: of the engine.
            env_ids: (n,) environments; all if None.
            fixed: arguments that are the same for all environments.
            rowwise: (n, ...) arguments with a row for each of them.
        """
        # As arrays: a tensor on its way through a pipe takes 100 microseconds, an array 5.
        same = tuple(value.numpy() if isinstance(value, Tensor) else value for value in fixed)
        arrays = tuple(None if values is None else values.numpy() for values in rowwise)
        rows = None if env_ids is None else env_ids.numpy()
        for number, (start, stop) in enumerate(self.ranges):
            if rows is None:
                yield number, (method, same, _rows(arrays, slice(start, stop)), None)
                continue
            here = (rows >= start) & (rows < stop)
            if here.any():
                yield number, (method, same, _rows(arrays, here), rows[here] - start)

    # Snapshots and the rest ------------------------------------------------------------------------------------------

    def save_state(self) -> SplitSnapshot:
        return SplitSnapshot(self.ranges, tuple(self._workers.call("save_state")), self.saved_commands())

    def load_state(self, state: SplitSnapshot) -> None:
        if state.ranges != self.ranges:
            raise ConfigurationError(
                f"the state was saved by {len(state.ranges)} workers and this engine has {len(self.ranges)}: load it "
                "with the number of environments and workers that it was saved with"
            )
        self._behind.update(range(len(self.ranges)))
        self._workers.call_each("load_state", {number: (own,) for number, own in enumerate(state.states)})
        self.load_commands(state.commands)

    @property
    def build_report(self) -> tuple[Approximation, ...]:
        return self._built[0]

    def built_model(self) -> tuple[BuiltModel, ...]:
        return self._built[1]

    @property
    def native(self) -> Workers:
        """The workers, which have the engine's own objects in their processes."""
        return self._workers

    def close(self) -> None:
        self._finalizer()


def _rows(arrays: tuple[npt.NDArray[Any] | None, ...], rows: Any) -> tuple[npt.NDArray[Any] | None, ...]:
    return tuple(None if values is None else values[rows] for values in arrays)


def _release(workers: Workers, owner: int) -> None:
    if os.getpid() == owner:  # a process that was forked from it ends too, and these are not its own
        workers.close()
