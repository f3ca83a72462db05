"""PhysX stepped through SAPIEN without ORBIT: an engine's bodies and commands, and state packed once a control step.

The yardstick of ``benchmarks/overhead.py``: one world of all environments, and for an engine that is divided over
workers its worlds in as many processes.
"""

# pyright: reportAttributeAccessIssue=false

from __future__ import annotations

import dataclasses
from typing import ClassVar

import numpy as np
import torch
from torch import Tensor

from orbit_core.interfaces import Engine
from orbit_core.plugin_kit.split_engine import SplitEngine
from orbit_sapien.engine import SapienEngine

Command = tuple[Tensor, Tensor, Tensor]
"""Position targets, velocity targets and efforts (N, J)."""


class RawEngine(SapienEngine):
    """Engine that sends commands, steps and packs, and computes nothing from what it packed."""

    def step(self, steps: int) -> None:
        systems, _ = self.native
        self._drives.send(self._drives.commands(*self._commands))
        for _ in range(steps):
            for system in systems:
                system.step()
        for system in systems:
            np.frombuffer(system.pack(), np.float32)
        self._state.invalidate()


class ThreadedRawEngine(RawEngine):
    """The same with PhysX's own threads."""

    threads: ClassVar[int] = 2
    """Threads of PhysX."""


class RawStepper:
    """An engine's environments stepped by a copy; parameters randomised per environment are not copied."""

    def __init__(self, engine: Engine, copy: Engine) -> None:
        self._source, self._copy = engine, copy
        self._joints = torch.arange(len(engine.layout.joints))

    def synchronize(self) -> None:
        """Take over the engine's present state."""
        source, own = self._source, self._copy
        for entity in own.layout.entities:
            root = entity.root_link
            velocity = None if entity.spec.fixed_base else source.link_velocities[:, root].clone()
            own.write_root_state(entity.index, source.link_poses[:, root].clone(), velocity)
        if len(self._joints):
            own.write_joint_state(self._joints, source.joint_positions.clone(), source.joint_velocities.clone())

    def command(self) -> Command:
        """The present commands of the engine's drives."""
        source = self._source
        return source.position_targets.clone(), source.velocity_targets.clone(), source.efforts.clone()

    def step(self, command: Command, steps: int) -> None:
        """Write what changed of a command, advance by physics steps, and read all state."""
        own = self._copy
        for target, values in zip((own.position_targets, own.velocity_targets, own.efforts), command, strict=True):
            target.copy_(values)
        own.step(steps)


def raw_steppers(engine: SapienEngine | SplitEngine) -> dict[str, RawStepper]:
    """Every way of stepping that may be the fastest, by name: in the calling thread, with two threads, in processes."""
    layout, num_envs, cpu = engine.layout, engine.num_envs, torch.device("cpu")
    whole = dataclasses.replace(engine.config, envs_per_world=num_envs)
    ways = {
        "one thread": RawStepper(engine, RawEngine(layout, num_envs, cpu, whole)),
        "two threads": RawStepper(engine, ThreadedRawEngine(layout, num_envs, cpu, whole)),
    }
    if isinstance(engine, SplitEngine):
        ways[f"{len(engine.ranges)} processes"] = RawStepper(
            engine, SplitEngine(RawEngine, layout, num_envs, engine.config, engine.ranges)
        )
    return ways
