"""Letting some environments come to rest while all others stand still."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, Protocol

import torch
from torch import Tensor

from orbit_core.interfaces import Engine


@dataclass(frozen=True)
class _Rest:
    """Where n environments have come to."""

    roots: list[tuple[int, Tensor, Tensor]]
    """Index of each entity whose base is free, and its root's pose (n, 7) and velocity (n, 6)."""
    joints: tuple[Tensor, Tensor]
    """(n, J) positions and velocities."""
    particles: list[tuple[Tensor, Tensor]]
    """(n, P, 3) positions and velocities of each deformable."""


class Stateful(Protocol):
    """What remembers something from step to step."""

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
    is the same whoever is settled with it, so that an environment does the same whatever their number.

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
    before, kept = engine.save_state(), [other.save_state() for other in others]
    try:
        step(steps)
        rest = _read(engine, slice(None) if rows is None else rows)
    finally:
        engine.load_state(before)
        for other, state in zip(others, kept, strict=True):
            other.load_state(state)
    _write(engine, rest, rows)


def _read(engine: Engine, rows: Tensor | slice) -> _Rest:
    poses, velocities = engine.link_poses[rows], engine.link_velocities[rows]
    free = [entity for entity in engine.layout.entities if not entity.spec.fixed_base]
    return _Rest(
        [(e.index, poses[:, e.root_link].clone(), velocities[:, e.root_link].clone()) for e in free],
        (engine.joint_positions[rows].clone(), engine.joint_velocities[rows].clone()),
        [
            (engine.particle_positions(i)[rows].clone(), engine.particle_velocities(i)[rows].clone())
            for i in range(len(engine.layout.scene.deformables))
        ],
    )


def _write(engine: Engine, rest: _Rest, rows: Tensor | None) -> None:
    for entity, pose, velocity in rest.roots:
        engine.write_root_state(entity, pose, velocity, rows)
    if rest.joints[0].shape[1]:
        joints = torch.arange(rest.joints[0].shape[1], device=engine.device)
        engine.write_joint_state(joints, *rest.joints, rows)
    for index, (positions, velocities) in enumerate(rest.particles):
        engine.write_particles(index, positions, velocities, rows)
