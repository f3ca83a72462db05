"""Bullet's stepping without ORBIT: the same worlds, drives, substeps and read-back, and nothing of the task.

The yardstick of ``benchmarks/overhead.py``: an engine of its own, told the joint commands directly. Per step and
environment it sets its drives, steps, and reads joints and links, as any program that learns on Bullet must.
"""

from __future__ import annotations

import torch
from torch import Tensor

from orbit_bullet.config import BulletConfig
from orbit_bullet.engine import BulletEngine

Command = tuple[Tensor, Tensor, Tensor]
"""Position targets, velocity targets and efforts (N, J)."""


class RawStepper:
    """Worlds of the same scene; parameters randomised per environment are not copied."""

    def __init__(self, engine: BulletEngine, workers: int) -> None:
        self._source = engine
        config = BulletConfig(workers=workers)
        self._engine = BulletEngine(engine.layout, engine.num_envs, torch.device("cpu"), config)
        self._joints = torch.arange(len(engine.layout.joints))

    def synchronize(self) -> None:
        """Take over the engine's present state."""
        source, own = self._source, self._engine
        for entity in own.layout.entities:
            root = entity.root_link
            velocity = None if entity.spec.fixed_base else source.link_velocities[:, root].clone()
            own.write_root_state(entity.index, source.link_poses[:, root].clone(), velocity)
        if len(self._joints):
            own.write_joint_state(self._joints, source.joint_positions.clone(), source.joint_velocities.clone())
        own.native.settle()

    def command(self) -> Command:
        """What the engine's drives are told now."""
        source = self._source
        return source.position_targets.clone(), source.velocity_targets.clone(), source.efforts.clone()

    def step(self, command: Command, steps: int) -> None:
        """Write a command, then advance by physics steps."""
        own = self._engine
        own.position_targets.copy_(command[0])
        own.velocity_targets.copy_(command[1])
        own.efforts.copy_(command[2])
        own.native.call("step", steps)


def raw_steppers(engine: BulletEngine) -> dict[str, RawStepper]:
    """Every way of stepping that may be the fastest, by name: with a process per core, and with one."""
    return {"a process per core": RawStepper(engine, 0), "one process": RawStepper(engine, 1)}
