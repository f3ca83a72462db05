"""Functions without their Python: traced once per state of a schedule, then replayed, compiled or recorded."""

from __future__ import annotations

from collections.abc import Callable, Hashable, Iterator, Sequence
from contextlib import contextmanager
from contextvars import ContextVar

import torch
from torch import Tensor, fx

from orbit_core.capture.compile import compiled
from orbit_core.capture.python_state import PythonState, frozen_by_trace
from orbit_core.capture.trace import CapturedTrace, NotTraceable, Tracer
from orbit_core.interfaces import World
from orbit_core.interfaces.capture import Schedule

_wanted: ContextVar[bool] = ContextVar("kernels wanted", default=False)


@contextmanager
def fusing(wanted: bool) -> Iterator[None]:
    """Ask functions that can be one kernel, such as a servo's law, to be one within this context."""
    token = _wanted.set(wanted)
    try:
        yield
    finally:
        _wanted.reset(token)


def kernels_wanted() -> bool:
    """Return whether :func:`fusing` asks for kernels here."""
    return _wanted.get()


class CapturedFunction:
    """Operations that run in Python once, while they are traced, and are replayed without it from then on.

    Results hold until the next call: clone what is kept.
    Counters on the host are the caller's. Where the engine makes recordings, a replay is one.

    Args:
        world: that they work on.
        operations: on tensors and on the world; they return tensors.
        compile: True to compile the stages between calls to the engine.
        python: values of plain Python that the operations read, and must not change.
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
        """Reason why the operations cannot be repeated without Python; empty if they can, or have not run."""

    def __call__(self) -> tuple[Tensor, ...]:
        return self._traced() if self.replay is None else self.replay()

    def _traced(self) -> tuple[Tensor, ...]:
        world, python = self._world, self._python()
        tracer = Tracer(world.engine)
        if world.schedule is not None:
            world.schedule.move(world.schedule.key, 0)  # what was derived before must not be taken for part of the step
        # Without gradients, for a replay writes into the tensors that it read.
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
    """Return the operations as the engine's recording, if it makes one."""
    outputs: tuple[Tensor, ...] = ()

    def run() -> None:
        nonlocal outputs
        outputs = operations()

    # The engine may run the operations once while it records them.
    recording = record(run)
    if recording is run:
        return operations

    def replay() -> tuple[Tensor, ...]:
        recording()
        return outputs

    return replay


_Keys = tuple[Hashable, ...]


class ScheduledFunction:
    """Captures operations once for each key of their schedules, and replays what it has captured.

    Args:
        schedules: counters that decide which operations run, and that the operations move on.
        capture: makes a captured function of the operations.
    """

    def __init__(self, schedules: Sequence[Schedule], capture: Callable[[], CapturedFunction]) -> None:
        self._schedules = tuple(schedules)
        self._capture = capture
        # Function of each key, with the key after it and the steps that each schedule counts meanwhile
        self._known: dict[_Keys, tuple[CapturedFunction, _Keys, tuple[int, ...]]] = {}
        self.refusal = ""
        """Reason why the operations cannot be repeated without Python; empty as far as they can."""

    @property
    def captured(self) -> int:
        """Number of keys that were captured."""
        return len(self._known)

    @property
    def functions(self) -> tuple[CapturedFunction, ...]:
        """Captured functions, one for each key."""
        return tuple(function for function, _, _ in self._known.values())

    def forget(self) -> None:
        """Capture every key again when it is next met."""
        self._known.clear()

    @property
    def ready(self) -> bool:
        """True if the operations of the present key were captured."""
        return self._key() in self._known

    def __call__(self) -> tuple[Tensor, ...]:
        key = self._key()
        # Keyed by all that Python decides, so that a replay never runs a branch that Python would not take.
        known = self._known.get(key)
        if known is not None:
            function, following, steps = known
            outputs = function()
            for schedule, own, count in zip(self._schedules, following, steps, strict=True):
                schedule.move(own, count)
            return outputs
        before = [schedule.count for schedule in self._schedules]
        function = self._capture()
        outputs = function()
        self.refusal = function.refusal
        if function.replay is not None:
            steps = tuple(schedule.count - old for schedule, old in zip(self._schedules, before, strict=True))
            self._known[key] = function, self._key(), steps
        return outputs

    def _key(self) -> _Keys:
        return tuple([schedule.key for schedule in self._schedules])
