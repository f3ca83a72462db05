"""The environment's step as one recording, where the engine makes one and nothing in the step needs Python anew."""

from __future__ import annotations

from collections.abc import Callable

from torch import Tensor

from orbit_core.agent import Cut
from orbit_core.tasks.task import Task
from orbit_core.world import SimulatedWorld

StepOutcome = tuple[Tensor, Tensor, Tensor, Tensor]
"""Reward (N,), terminated, truncated, and either of them (N,) bool."""


class RecordedStep:
    """Calls a step, or replays it, and keeps what is counted on the host right either way."""

    def __init__(
        self,
        world: SimulatedWorld,
        task: Task,
        cut: Cut,
        step: Callable[[], StepOutcome],
        observe: Callable[[], Tensor],
    ) -> None:
        self._world, self._task, self._cut = world, task, cut
        self._step, self._observe = step, observe
        self._count = 0
        self._outcome: StepOutcome | None = None
        self._observation: Tensor | None = None
        self._observed = -1
        """Version of the world's state that the observation shows."""
        self._ran = False
        self._run = world.engine.record(self._once)

    def observation(self) -> Tensor | None:
        """(N, O) of the state after the step, if nothing has changed since."""
        if self._observation is None or self._observed != self._world.clock.version:
            return None
        return self._observation.clone()

    def __call__(self) -> StepOutcome:
        self._count = self._cut.graph.step_count
        self._world.clock.touch()  # what was derived before must not be taken for part of the recording
        steps, self._ran = self._world.clock.steps, False
        self._run()
        if not self._ran:
            self._cut.acted(self._count)
        self._world.clock.advance(steps + self._task.decimation - self._world.clock.steps)
        self._observed = self._world.clock.version
        assert self._outcome is not None
        reward, terminated, truncated, done = self._outcome
        return reward.clone(), terminated.clone(), truncated.clone(), done  # a replay writes the same tensors

    def _once(self) -> None:
        self._cut.again(self._count)
        self._outcome = self._step()
        self._observation = self._observe()
        self._ran = True


def needs_python(world: SimulatedWorld, task: Task, cut: Cut) -> str:
    """What of a step Python has to do each time anew; empty if nothing."""
    if world.sensors:
        return f"sensor '{next(iter(world.sensors))}' keeps its own time"
    if world.actuators.delayed:
        return "an actuator's delay"
    if type(task).advance is not Task.advance:
        return f"{type(task).__name__}.advance"
    for runner in cut.graph.runners:
        if runner.period != 1:
            return f"node '{runner.node.name}' has a rate of its own"
        if runner.node.memory():
            return f"node '{runner.node.name}' remembers"
    return ""
