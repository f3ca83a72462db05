"""PhysX stepped through SAPIEN without ORBIT: an engine's world and commands, and its state packed once a control step.

The yardstick of ``benchmarks/overhead.py``.
"""

# pyright: reportAttributeAccessIssue=false

from __future__ import annotations

import dataclasses

import numpy as np
import numpy.typing as npt
import torch

from orbit_sapien.engine import SapienEngine

Command = npt.NDArray[np.float32]
"""(3, num_envs, joints) drive targets, velocity targets and generalised forces."""


class RawStepper:
    """Separate world like an engine's; parameters randomised per environment are not copied."""

    def __init__(self, engine: SapienEngine, workers: int) -> None:
        self._source = engine
        config = dataclasses.replace(engine.config, workers=workers)
        self._copy = SapienEngine(engine.layout, engine.num_envs, torch.device("cpu"), config)
        self._system, _ = self._copy.native
        self._joints = self._copy.native_joints
        self._last = self._copy.command

    def synchronize(self) -> None:
        """Take over the engine's present state."""
        self._copy.load_state(self._source.save_state())
        self._last = np.full_like(self._source.command, np.nan)

    def command(self) -> Command:
        """The present commands of the engine's drives."""
        return self._source.command.copy()

    def step(self, command: Command, steps: int) -> None:
        """Write what changed of a command, advance by physics steps, and read all state."""
        changed = command != self._last
        for row, joint in np.argwhere(changed[0]).tolist():
            self._joints[row][joint].set_drive_target(float(command[0, row, joint]))
        for row, joint in np.argwhere(changed[1]).tolist():
            self._joints[row][joint].set_drive_velocity_target(float(command[1, row, joint]))
        self._last = command
        for _ in range(steps):
            self._system.step()
        np.frombuffer(self._system.pack(), np.float32)


def raw_steppers(engine: SapienEngine) -> dict[str, RawStepper]:
    """Every way of stepping that may be the fastest, by name: in the calling thread, and with two workers."""
    return {f"{workers} workers": RawStepper(engine, workers) for workers in (0, 2)}
