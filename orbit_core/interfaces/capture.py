"""Interface of engines and renderers to a captured step, which is traced once and then repeated without its Python.

Marks on the interface's methods declare their role in such a step: a *read* of the state, or a *call* that changes or
measures something. While a :class:`CallTracer` watches they go through it, also where a subclass overrides them.
"""

from __future__ import annotations

import functools
import inspect
import threading
from collections.abc import Callable, Hashable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any, ClassVar, Protocol, TypeVar

from torch import Tensor

_Function = TypeVar("_Function", bound=Callable[..., Any])
_MARK = "_use_in_a_captured_step"


class CaptureFacet:
    """Part of an engine or renderer for captured steps; this one does nothing special, which is always right."""

    takes_masks: ClassVar[frozenset[str]] = frozenset()
    """Names of the methods whose ``env_ids`` may also be a mask (N,) bool; n is then N, and rows outside of the mask
    count for nothing. An engine whose :meth:`record` records needs them for what happens within a recording."""

    def record(self, operations: Callable[[], None]) -> Callable[[], None]:
        """Return a function that does what ``operations`` do: where the engine can, recorded once and then replayed.

        ``operations`` steps the engine and works on tensors of its device, and no step of it waits for the device.
        What it remembers it writes in place. Its calls on the host happen when it is recorded, and when it is replayed
        do not. It may be called again from the start where recording fails.

        An engine that records nothing gives back ``operations`` itself.
        """
        return operations

    def expression(self, name: str) -> Tensor | None:
        """Return a state tensor, by name, as operations of torch on memory of the engine's that never moves.

        A trace of a step takes these operations in, and computes what it needs of the tensor and no more. None where
        there is nothing to gain. What they compute is current after :meth:`settle`.
        """
        return None

    def lead(self, name: str) -> Lead | None:
        """Return what a call of the engine's method ``name`` begins with, for a trace to take in; None if nothing.

        A trace runs the lead's operations with its own, which compiled become one kernel, and then the rest.
        """
        return None

    def settle(self) -> None:
        """Bring what :meth:`expression` reads up to date, after a step or a write."""


@dataclass(frozen=True)
class Lead:
    """Beginning of an engine's call as operations of torch."""

    prepare: Callable[[], None]
    """Brings what the operations read up to date; runs before all operations since the engine's last call."""
    operations: Callable[[], None]
    """Works on the engine's memory that never moves."""
    rest: Callable[..., Any]
    """Does what is left of the call, with its arguments."""


@dataclass(frozen=True)
class Call:
    """Role of a method in a captured step: a change, or a measurement that gives tensors."""

    rows: tuple[str, ...] = ()
    """Names of the arguments with a row for each environment of ``env_ids``."""
    measures: bool = False
    """Whether it gives tensors, with a row for each environment."""


@dataclass(frozen=True)
class EngineCall:
    """One call, as a watcher gets it."""

    owner: Traceable
    """Engine or renderer that was called."""
    name: str
    """Name of the method."""
    kind: Call
    """Declaration of the method: a change or a measurement."""
    function: Callable[..., Any]
    """Bound to its owner, and watched no more."""
    arguments: Mapping[str, Any]
    """All of them by name, defaults with them."""


class CallTracer(Protocol):
    """Watcher that gets reads and calls, and makes them."""

    incomplete: bool
    """True if the step made memory that later steps use."""

    def read(self, owner: Traceable, name: str, function: Callable[[], Tensor]) -> Tensor:
        """The value of a property that reads the state."""
        ...

    def call(self, call: EngineCall) -> Any:
        """Make the call, and return its result."""
        ...


class Schedule(Protocol):
    """Counters of plain Python that decide what a step runs: which sensors are due, and which nodes.

    One clock rules all environments, so the key of a step repeats with a period, and a step is captured once for each
    key.
    """

    @property
    def period(self) -> int:
        """Steps after which the same parts are due again."""
        ...

    @property
    def key(self) -> Hashable:
        """Value that decides what the next step runs."""
        ...

    @property
    def count(self) -> int:
        """Steps made so far."""
        ...

    def move(self, key: Any, steps: int) -> None:
        """Move on by steps that were repeated without Python, and drop what was derived from the state before them.

        Args:
            key: after the steps.
            steps: to count.
        """
        ...


class _Watching(threading.local):
    watcher: CallTracer | None = None


# For each thread, because environments of several threads trace on their own.
_watching = _Watching()


def is_tracing() -> bool:
    """Return True while a step is traced in this thread: nothing may then look at the numbers that tensors hold."""
    return _watching.watcher is not None


def report_new_memory() -> None:
    """Report to a trace that memory of later steps was made within it, so that only a next trace holds for them."""
    if _watching.watcher is not None:
        _watching.watcher.incomplete = True


@contextmanager
def traced_by(watcher: CallTracer) -> Iterator[None]:
    """Report every read and call in this thread to the watcher."""
    # Nested traces give the thread back to the outer one.
    before, _watching.watcher = _watching.watcher, watcher
    try:
        yield
    finally:
        _watching.watcher = before


def reads_state(function: _Function) -> _Function:
    """Mark the getter of a property that a captured step may read."""
    setattr(function, _MARK, None)
    return function


def changes(*rows: str) -> Callable[[_Function], _Function]:
    """Mark a method that a captured step may call; ``rows`` name the arguments with a row for each of ``env_ids``."""
    return _marking(Call(rows))


def measures(*rows: str) -> Callable[[_Function], _Function]:
    """Mark a method like :func:`changes` that gives tensors with such rows."""
    return _marking(Call(rows, measures=True))


class Traceable:
    """A class whose marked methods, and their overrides, report their use to the watcher."""

    capture: CaptureFacet = CaptureFacet()
    """What the engine does for captured steps."""

    def __init_subclass__(cls, **keywords: Any) -> None:
        super().__init_subclass__(**keywords)
        for name, member in list(vars(cls).items()):
            # Marks stand in the contract's classes; what overrides a marked method in a plugin is wrapped
            # without a new mark.
            marks = [mark for kind in cls.__mro__ if (mark := _mark_of(vars(kind).get(name))) is not None]
            if not marks:
                continue
            if isinstance(member, property):
                assert member.fget is not None
                setattr(cls, name, property(_watched_read(name, member.fget), doc=member.__doc__))
            elif inspect.isfunction(member) and marks[0][0] is not None:
                setattr(cls, name, _watched_call(name, marks[0][0], member))


def _marking(kind: Call) -> Callable[[_Function], _Function]:
    def mark(function: _Function) -> _Function:
        setattr(function, _MARK, kind)
        return function

    return mark


def _mark_of(member: object) -> tuple[Call | None] | None:
    """Return the mark in a tuple, for that of a read is None."""
    function = member.fget if isinstance(member, property) else member
    return (getattr(function, _MARK),) if hasattr(function, _MARK) else None


def _watched_read(name: str, read: Callable[[Any], Tensor]) -> Callable[[Any], Tensor]:
    @functools.wraps(read)
    def watched(owner: Traceable) -> Tensor:
        watcher = _watching.watcher
        # The usual case first: each read of the state passes here, and pays for one look at a variable of the thread.
        return read(owner) if watcher is None else watcher.read(owner, name, functools.partial(read, owner))

    return watched


def _watched_call(name: str, kind: Call, call: Callable[..., Any]) -> Callable[..., Any]:
    signature = inspect.signature(call)

    @functools.wraps(call)
    def watched(owner: Traceable, *arguments: Any, **keywords: Any) -> Any:
        watcher = _watching.watcher
        if watcher is None:
            return call(owner, *arguments, **keywords)
        # By name, so that a tracer finds the arguments with rows, however they were given.
        bound = signature.bind(owner, *arguments, **keywords)
        bound.apply_defaults()
        given = dict(list(bound.arguments.items())[1:])
        return watcher.call(EngineCall(owner, name, kind, functools.partial(call, owner), given))

    return watched
