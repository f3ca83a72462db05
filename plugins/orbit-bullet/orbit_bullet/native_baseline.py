"""Bullet's stepping without ORBIT: the same worlds, drives, substeps and read-back only.

The yardstick of ``benchmarks/overhead.py``. One way calls PyBullet by hand in this process; the other has worker
processes do their steps, without what the core does around them.
"""

from __future__ import annotations

from typing import Protocol

import numpy as np
import torch
from torch import Tensor

from orbit_bullet.config import BulletConfig
from orbit_bullet.engine import BulletEngine
from orbit_bullet.pool import LocalPool
from orbit_bullet.simulation import Simulation

Command = tuple[Tensor, Tensor, Tensor]
"""Position targets, velocity targets and efforts (N, J)."""


class RawStepper(Protocol):
    """One way of stepping."""

    def synchronize(self) -> None: ...
    def command(self) -> Command: ...
    def step(self, command: Command, steps: int) -> None: ...


class WorkerStepper:
    """Worlds of the same scene in worker processes; parameters randomised per environment are not copied."""

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
        """The present commands of the engine's drives."""
        source = self._source
        return source.position_targets.clone(), source.velocity_targets.clone(), source.efforts.clone()

    def step(self, command: Command, steps: int) -> None:
        """Write a command, then advance by physics steps."""
        self._write(command)
        self._engine.native.call("step", steps)

    def _write(self, command: Command) -> None:
        own = self._engine
        for target, values in zip((own.position_targets, own.velocity_targets, own.efforts), command, strict=True):
            target.copy_(values)


class HandStepper(WorkerStepper):
    """PyBullet called by hand: drives set and joints read at each step, then links; contacts are not read."""

    def __init__(self, engine: BulletEngine) -> None:
        super().__init__(engine, 1)
        assert isinstance(self._engine.native, LocalPool)
        self._simulations = self._engine.native.shard.simulations

    def step(self, command: Command, steps: int) -> None:
        """Write a command, then advance by physics steps."""
        self._write(command)
        for simulation in self._simulations:
            _step_by_hand(simulation, steps)


def _step_by_hand(simulation: Simulation, steps: int) -> None:
    client, stage, layout = simulation.client, simulation.stage, simulation.layout
    slots = range(stage.count)
    jointed = [entity for entity in layout.entities if stage.joints[entity.index]]
    simulation.actuation.prepare()
    positions, velocities = simulation.joint_state
    for _ in range(steps):
        simulation.actuation.apply(positions, velocities)
        simulation.loads.apply()
        client.stepSimulation()
        for slot in slots:
            for entity in jointed:
                states = client.getJointStates(stage.bodies[slot][entity.index], stage.joints[entity.index])
                positions[slot, entity.joints] = [state[0] for state in states]
                velocities[slot, entity.joints] = [state[1] for state in states]
    for slot in slots:
        for entity in layout.entities:
            body = stage.bodies[slot][entity.index]
            if not entity.spec.fixed_base:
                np.array(sum(client.getBasePositionAndOrientation(body) + client.getBaseVelocity(body), ()))
            if len(stage.links[entity.index]) > 1:
                client.getLinkStates(body, stage.links[entity.index][1:], 1, 1)


def raw_steppers(engine: BulletEngine) -> dict[str, RawStepper]:
    """Every way of stepping that may be the fastest, by name."""
    return {"by hand in one process": HandStepper(engine), "a process per core": WorkerStepper(engine, 0)}
