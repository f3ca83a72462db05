"""What a step does, as data: tensor operations in stages, between calls to the engine.

A :class:`Tracer` notes each operation of torch and each call of an engine or renderer while a step runs, with the
tensors that they took. A :class:`orbit_core.capture.stages.CapturedTrace` repeats them on the same memory, without the
Python around them.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Any

import torch
from torch import Tensor
from torch.overrides import TorchFunctionMode
from torch.utils._python_dispatch import TorchDispatchMode, _get_current_dispatch_mode_stack
from torch.utils._pytree import tree_leaves

from orbit_core.dynamics.indexing import is_mask
from orbit_core.interfaces import Engine
from orbit_core.interfaces.capture import EngineCall, Traceable, traced_by

_HOST_READS = frozenset({Tensor.numpy, Tensor.tolist, Tensor.__array__, Tensor.__dlpack__})
_DECIDING = (torch.Tag.data_dependent_output, torch.Tag.dynamic_output_shape)


class NotTraceable(Exception):
    """The step does what no trace can repeat; says what."""


@dataclass(frozen=True, eq=False)
class Operation:
    """One operation of torch with the very tensors that it took and gave."""

    function: Any
    arguments: tuple[Any, ...]
    keywords: dict[str, Any]
    result: Any


@dataclass(frozen=True, eq=False)
class NotedCall:
    """One call to an engine or renderer, and what it measured."""

    call: EngineCall
    results: list[Tensor]
    """Memory of the trace's own, that later operations read."""

    @property
    def taken(self) -> list[Tensor]:
        """Tensors among its arguments."""
        return tensors_of(dict(self.call.arguments))

    def repeat(self, arguments: Mapping[str, Any]) -> None:
        """Call again, with these arguments."""
        given = dict(arguments)
        env_ids = given.get("env_ids")
        if by_index(self.call) and is_mask(env_ids):
            rows = env_ids.nonzero().squeeze(-1)
            if not len(rows):
                return
            for name in self.call.kind.rows:
                given[name] = None if given[name] is None else given[name][rows]
            given["env_ids"] = rows
            for kept, measured in zip(self.results, _fields(self.call.function(**given)), strict=True):
                kept[rows] = measured
        else:
            for kept, measured in zip(self.results, _fields(self.call.function(**given)), strict=True):
                kept.copy_(measured)


@dataclass(eq=False)
class Stage:
    """Reads of the engine, then operations, then one call."""

    reads: dict[str, Tensor] = field(default_factory=dict)
    """What was read, and the tensor that the operations took."""
    expressed: dict[str, Tensor] = field(default_factory=dict)
    """What was read by way of operations."""
    operations: list[Operation] = field(default_factory=list)
    call: NotedCall | None = None


class Tracer(TorchDispatchMode):
    """Notes what runs within it.

    Args:
        engine: whose state is read.
    """

    def __init__(self, engine: Engine) -> None:
        super().__init__()
        self.stages = [Stage()]
        self.refusal = ""
        """What no trace can repeat; empty if nothing."""
        self.incomplete = False
        self._engine = engine
        self.paused = False

    @contextmanager
    def tracing(self) -> Iterator[None]:
        """Note torch's operations, and the uses of the engine in the place of the operations within them."""
        with traced_by(self), self, _HostReads(self):
            yield

    def __torch_dispatch__(
        self, func: Any, types: Any, args: tuple[Any, ...] = (), kwargs: dict[str, Any] | None = None
    ) -> Any:
        keywords = kwargs or {}
        if self.paused:
            return func(*args, **keywords)
        if _decides(func, args):
            self.refusal = f"{func} looks at a tensor's values"
        result = func(*args, **keywords)
        if _comes_from_host((args, keywords), result):
            return result  # a constant that Python made: its copy on the device is one too
        self.stages[-1].operations.append(Operation(func, _without_copy(func, args), keywords, result))
        return result

    def read(self, owner: Traceable, name: str, function: Callable[[], Tensor]) -> Tensor:
        """Note what is read of the engine, once between two calls: it shows the state since the last."""
        if self.paused:
            return function()
        if owner is not self._engine:
            self.refusal = f"the state of another engine, its {name}, is read"
        reads, expressed = self.stages[-1].reads, self.stages[-1].expressed
        if name in reads or name in expressed:
            return reads[name] if name in reads else expressed[name]
        with self._silence():
            self._engine.capture.settle()
        value = self._engine.capture.expression(name)
        if value is not None:
            return expressed.setdefault(name, value)
        with self._silence():
            return reads.setdefault(name, function())

    def call(self, call: EngineCall) -> Any:
        """Make a call, and end the stage with it."""
        if self.paused:
            return call.function(**call.arguments)
        with self._silence():
            on_host = by_index(call)
            if on_host and self._engine.device.type != "cpu":
                self.refusal = f"{type(call.owner).__name__}'s {call.name} takes no mask"
            if call.kind.measures:
                result = call.function(**{**call.arguments, **({"env_ids": None} if on_host else {})})
                result = _kept(result)
                noted = NotedCall(call, _fields(result))
            else:
                result, noted = None, NotedCall(call, [])
                noted.repeat(call.arguments)
        self.stages[-1].call = noted
        self.stages.append(Stage())
        return result

    @contextmanager
    def _silence(self) -> Iterator[None]:
        before, self.paused = self.paused, True
        try:
            yield
        finally:
            self.paused = before


class _HostReads(TorchFunctionMode):
    """Notes that Python takes a tensor's values past torch's dispatcher, which a trace could not repeat."""

    def __init__(self, tracer: Tracer) -> None:
        super().__init__()
        self._tracer = tracer

    def __torch_function__(
        self, func: Any, types: Any, args: tuple[Any, ...] = (), kwargs: dict[str, Any] | None = None
    ) -> Any:
        if func in _HOST_READS and not self._tracer.paused and self._tracer in _get_current_dispatch_mode_stack():
            self._tracer.refusal = f"Tensor.{func.__name__} looks at a tensor's values"
        return func(*args, **(kwargs or {}))


def tensors_of(tree: Any) -> list[Tensor]:
    """The tensors among the leaves of a structure."""
    return [leaf for leaf in tree_leaves(tree) if isinstance(leaf, Tensor)]


def by_index(call: EngineCall) -> bool:
    """Whether environments are given by a mask that the method does not take: to find them is to look at the mask."""
    return is_mask(call.arguments.get("env_ids")) and call.name not in call.owner.capture.takes_masks


def _fields(measured: Any) -> list[Tensor]:
    """The tensors of what a call gave: a tensor, a dataclass of them, or nothing."""
    if dataclasses.is_dataclass(measured):
        return [value for f in dataclasses.fields(measured) if (value := getattr(measured, f.name)) is not None]
    return [] if measured is None else [measured]


def _kept(measured: Any) -> Any:
    """The same in memory of its own."""
    if isinstance(measured, Tensor):
        return measured.clone()
    names = [f.name for f in dataclasses.fields(measured) if getattr(measured, f.name) is not None]
    return dataclasses.replace(measured, **{name: getattr(measured, name).clone() for name in names})


def _decides(function: Any, arguments: tuple[Any, ...]) -> bool:
    """Whether the values of an operation's tensors decide what Python sees of it."""
    if function is torch.ops.aten.index.Tensor:
        return any(index is not None and index.dtype == torch.bool for index in arguments[1])
    return any(tag in function.tags for tag in _DECIDING)


def _comes_from_host(taken: Any, result: Any) -> bool:
    tensors = tensors_of(taken)
    on_device = isinstance(result, Tensor) and result.device.type != "cpu"
    return on_device and bool(tensors) and all(tensor.device.type == "cpu" for tensor in tensors)


def _without_copy(function: Any, arguments: tuple[Any, ...]) -> tuple[Any, ...]:
    """The arguments, with a number that is written to places given by index beside them, and not on the host.

    Torch would copy it to the device each time. What is written by mask is given with the launch, and must stay.
    """
    if function is not torch.ops.aten.index_put_.default:
        return arguments
    target, indices, value, *rest = arguments
    if value.dim() or any(index is not None and index.dtype == torch.bool for index in indices):
        return arguments
    return (target, indices, value.to(target.device), *rest)
