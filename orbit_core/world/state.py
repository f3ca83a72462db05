"""Clock, snapshots, copies, settling and divergence of a simulated world's state."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, Protocol

import torch
from torch import Tensor

from orbit_core.actuators import Actuators
from orbit_core.dynamics.arguments import whole_number
from orbit_core.dynamics.indexing import RowSelector
from orbit_core.interfaces import ArgumentError, Engine, UnsupportedCapabilityError, World, diverged


class Clock:
    """``version`` differs whenever the state may have changed; ``steps`` counts physics steps."""

    def __init__(self) -> None:
        self.version = 0
        self.steps = 0

    def touch(self) -> None:
        """The state was written."""
        self.version += 1

    def advance(self, steps: int) -> None:
        """The state was stepped."""
        self.steps += steps
        self.version += 1


@dataclass(frozen=True)
class WorldState:
    """A snapshot of everything that the continuation depends on."""

    engine: Any
    """Snapshot of the engine, and of the matter solver."""
    actuators: Any
    """Gains, targets, delays and memory of the actuators."""
    active: Any
    """State of the objects' active models."""
    sensors: dict[str, Any]
    """Held and delayed values of the sensors, by name."""
    random: Any
    """Counters of the random streams."""
    markers: Tensor
    """(N, M, 7) poses of the markers."""
    steps: int
    """Physics steps so far."""
    made_by: tuple[str, int, tuple[str, ...], tuple[int, ...]]
    """Backend, number of environments, names of all things, and numbers of particles of deformables of its world."""


def check_copy(world: World, origin: World, source: int) -> None:
    """Refuse to copy environment ``source`` of ``origin`` into environments of ``world``, where that cannot be.

    Raises:
        ArgumentError: there is no such environment, or the worlds are not of one scene.
        UnsupportedCapabilityError: the scene has deformables.
    """
    whole_number(source, "source", 0, origin.num_envs - 1)
    # Names are compared, not numbers: equal names in the same order mean equal columns in every state tensor.
    own, other = world.layout, origin.layout
    if (other.links_by_name, other.joints_by_name) != (own.links_by_name, own.joints_by_name):
        raise ArgumentError("states are copied between worlds of one scene: the names of links and joints differ")
    if world.scene.deformables:
        raise UnsupportedCapabilityError("states of deformables are not copied: leave them out of the scene")


@dataclass(frozen=True)
class _Rest:
    """State of n environments."""

    roots: list[tuple[int, Tensor, Tensor]]
    """Index of each entity whose base is free, and its root's pose (n, 7) and velocity (n, 6)."""
    joints: tuple[Tensor, Tensor]
    """(n, J) positions and velocities."""
    particles: list[tuple[Tensor, Tensor]]
    """(n, P, 3) positions and velocities of each deformable."""


class Stateful(Protocol):
    """Part of a world with memory from step to step."""

    def save_state(self) -> Any:
        """A detached copy."""
        ...

    def load_state(self, state: Any) -> None:
        """Return to a saved state."""
        ...


def settle(
    engine: Engine, others: Sequence[Stateful], step: Callable[[int], None], steps: int, rows: Tensor | None
) -> None:
    """Simulate some environments for a while, commands held; for all others no time passes.

    Engines step all environments at once. So all are stepped and put back by a snapshot, and what has come of the
    chosen ones is written to them: positions and velocities, as after a reset, without what a solver starts from. That
    does not depend on the environments that are settled with it, nor on their number.

    Args:
        engine: that is stepped.
        others: what else remembers something, and is put back as well: delayed commands, active models.
        step: advances the engine by that many physics steps, with what must be done before each.
        steps: physics steps.
        rows: environments by index (n,); all if None.

    Raises:
        SimulationError: the engine diverged; the snapshot has been put back.
        UnsupportedCapabilityError: the engine has no snapshots of this scene.
    """
    # The snapshot is taken before anything moves, so that an engine without snapshots raises while nothing has changed.
    before, kept = engine.save_state(), [other.save_state() for other in others]
    try:
        step(steps)
        rest = _read(engine, slice(None) if rows is None else rows)
    # A diverging engine must not keep its broken state: the snapshot goes back even if the step raises.
    finally:
        engine.load_state(before)
        for other, state in zip(others, kept, strict=True):
            other.load_state(state)
    _write(engine, rest, rows)


def _read(engine: Engine, rows: Tensor | slice) -> _Rest:
    poses, velocities = engine.link_poses[rows], engine.link_velocities[rows]
    # A fixed root never moves, so that only free ones are written back.
    free = [entity for entity in engine.layout.entities if not entity.spec.fixed_base]
    return _Rest(
        [(e.index, poses[:, e.root_link].clone(), velocities[:, e.root_link].clone()) for e in free],
        # Copies, since loading the snapshot writes the same memory.
        (engine.joint_positions[rows].clone(), engine.joint_velocities[rows].clone()),
        [
            (engine.particle_positions(i)[rows].clone(), engine.particle_velocities(i)[rows].clone())
            for i in range(len(engine.layout.scene.deformables))
        ],
    )


def _write(engine: Engine, rest: _Rest, rows: Tensor | None) -> None:
    for entity, pose, velocity in rest.roots:
        engine.write_root_state(entity, pose, velocity, rows)
    # A scene of free bodies has no joints to write.
    if rest.joints[0].shape[1]:
        joints = torch.arange(rest.joints[0].shape[1], device=engine.device)
        engine.write_joint_state(joints, *rest.joints, rows)
    for index, (positions, velocities) in enumerate(rest.particles):
        engine.write_particles(index, positions, velocities, rows)


@dataclass(frozen=True)
class WorldParts:
    """Parts of a simulated world that its entities read and write."""

    engine: Engine
    """Engine that is stepped."""
    actuators: Actuators
    """Actuators of all joints."""
    clock: Clock
    """Counter of steps and changes."""
    selector: RowSelector
    """Mask of environments that calls are for."""


class DivergenceGuard:
    """Reset of environments that diverge, after each stretch of the engine's steps.

    The engine raises no error for them from then on. What else is reset where an episode begins is its owner's to do.
    Deformables are not looked at: those that diverge raise as before.

    Args:
        parts: of the world.
    """

    def __init__(self, parts: WorldParts) -> None:
        engine = parts.engine
        engine.raises_divergence = False
        self._parts = parts
        self.lost = torch.zeros(engine.num_envs, dtype=torch.bool, device=engine.device)
        """(N,) which environments have diverged since their owner last set it to False."""

    def look(self) -> None:
        """Reset the environments that diverged in the steps just taken."""
        engine = self._parts.engine
        # Links first, then joints: a joint may turn without bound while its link stays near.
        wrong = diverged(engine.link_poses, engine.link_velocities)
        wrong = wrong | diverged(engine.joint_positions, engine.joint_velocities)
        # Accumulated, because an environment may diverge in any stretch of one step of the environment.
        self.lost.logical_or_(wrong)
        rows = self._parts.selector.where(wrong)
        if rows is not None:
            engine.reset(rows)
            self._parts.actuators.reset(rows)
            self._parts.clock.touch()
