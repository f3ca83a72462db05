"""MuJoCo's batched stepping without ORBIT: the model and the controls of an engine, and nothing read back.

The yardstick of ``benchmarks/overhead.py``.
"""

# pyright: reportAttributeAccessIssue=false
# MuJoCo is an extension module without type information.

from __future__ import annotations

import mujoco
import mujoco.batch
import numpy as np
import numpy.typing as npt

from orbit_mujoco.engine import MujocoEngine

Command = npt.NDArray[np.float64]
"""(num_envs, actuators) what MuJoCo's position actuators are told."""


class RawStepper:
    """Separate batch of an engine's model; parameters randomised per environment are not copied."""

    def __init__(self, engine: MujocoEngine, threads: int, persistent: bool) -> None:
        model, self._source = engine.native
        self._batch = mujoco.batch.Batch(model, engine.num_envs, threads, persistent=persistent)

    def synchronize(self) -> None:
        """Take over the engine's present state."""
        self._batch.reset(stage=mujoco.mjtStage.mjSTAGE_NONE.value)
        self._batch.state[...] = self._source.state

    def command(self) -> Command:
        """The present commands of the engine's actuators."""
        return self._source.ctrl.copy()

    def step(self, command: Command, steps: int) -> None:
        """Write a command, then advance by physics steps."""
        self._batch.ctrl = command
        self._batch.step(nstep=steps)


def raw_steppers(engine: MujocoEngine) -> dict[str, RawStepper]:
    """Every way of stepping that may be the fastest, by name: with all cores and with one, persistent and not."""
    return {
        f"{'all cores' if threads == 0 else f'{threads} thread'}, {'' if persistent else 'not '}persistent": RawStepper(
            engine, threads, persistent
        )
        for threads in (0, 1)
        for persistent in (True, False)
    }
