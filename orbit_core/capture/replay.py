"""Parts of a step without their Python: traced once, then replayed, compiled or recorded by the engine."""

from __future__ import annotations

from collections.abc import Callable

import torch
from torch import Tensor, fx

from orbit_core.capture.compile import compiled
from orbit_core.capture.kernels import fusing
from orbit_core.capture.python_state import PythonState, frozen_by_trace
from orbit_core.capture.stages import CapturedTrace
from orbit_core.capture.trace import NotTraceable, Tracer
from orbit_core.interfaces import World


class CapturedFunction:
    """Runs operations as they are the first time, watching them, and from then on does the same without their Python.

    What they give holds until the next call: clone what is kept.
    What they count on the host is their caller's to keep right. Where the engine makes recordings, a replay is one.

    Args:
        world: that they work on.
        operations: on tensors and on the world; what they give are tensors.
        compile: whether to compile what lies between uses of the engine.
        python: the values of plain Python that the operations read; they must not change them.
    """

    def __init__(
        self,
        world: World,
        operations: Callable[[], tuple[Tensor, ...]],
        compile: bool,
        python: Callable[[], PythonState] = lambda: PythonState({}),
    ) -> None:
        self._world = world
        self._operations = operations
        self._python = python
        self._build = compiled if compile else _as_it_is
        self._compiles = compile
        self.replay: Callable[[], tuple[Tensor, ...]] | None = None
        self.refusal = ""
        """Why the operations cannot be repeated without Python; empty if they can, or have not run."""

    def __call__(self) -> tuple[Tensor, ...]:
        return self._traced() if self.replay is None else self.replay()

    def _traced(self) -> tuple[Tensor, ...]:
        world, python = self._world, self._python()
        tracer = Tracer(world.engine)
        if world.schedule is not None:
            world.schedule.move(world.schedule.key, 0)  # what was derived before must not be taken for part of the step
        with torch.no_grad(), fusing(self._compiles), tracer.tracing():
            outputs = self._operations()
        frozen, set_up = frozen_by_trace(python)
        self.refusal = tracer.refusal or frozen
        if not (self.refusal or set_up or tracer.incomplete):  # else a next trace finds what is new
            try:
                trace = CapturedTrace(world.engine, tracer.stages, outputs, self._build)
                self.replay = _recorded(trace, world.engine.capture.record)
            except NotTraceable as reason:
                self.refusal = str(reason)
        return outputs


def _as_it_is(graph: fx.GraphModule, inputs: list[Tensor], fixed: bool) -> fx.GraphModule:
    return graph


def _recorded(
    operations: Callable[[], tuple[Tensor, ...]], record: Callable[[Callable[[], None]], Callable[[], None]]
) -> Callable[[], tuple[Tensor, ...]]:
    """The operations as the engine's recording, if it makes one."""
    outputs: tuple[Tensor, ...] = ()

    def run() -> None:
        nonlocal outputs
        outputs = operations()

    recording = record(run)
    if recording is run:
        return operations

    def replay() -> tuple[Tensor, ...]:
        recording()
        return outputs

    return replay
