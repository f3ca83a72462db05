"""Traced steps as data: tensor operations in stages, between calls to the engine.

A :class:`Tracer` notes each operation of torch and each call of an engine or renderer while a step runs, with the
tensors that they took. A :class:`orbit_core.capture.trace.CapturedTrace` repeats them on the same memory, without the
Python around them."""

from __future__ import annotations

import dataclasses
import operator
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Any

import torch
from torch import Tensor, fx
from torch.overrides import TorchFunctionMode
from torch.utils._python_dispatch import TorchDispatchMode, _get_current_dispatch_mode_stack
from torch.utils._pytree import tree_leaves, tree_map, tree_map_only

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
    """Overload of the operation, as the dispatcher gives it."""
    arguments: tuple[Any, ...]
    """Positional arguments, tensors among them."""
    keywords: dict[str, Any]
    """Keyword arguments."""
    result: Any
    """Tensor or tensors that it returned."""


@dataclass(frozen=True, eq=False)
class NotedCall:
    """One call to an engine or renderer, and what it measured."""

    call: EngineCall
    """Method, owner and arguments."""
    results: list[Tensor]
    """Memory of the trace's own, that later operations read."""

    @property
    def taken(self) -> list[Tensor]:
        """Tensors among its arguments."""
        return tensors_of(dict(self.call.arguments))

    @property
    def is_plain(self) -> bool:
        """True if repeating it is calling its function again: it gives nothing, and no mask is turned into indices."""
        return not self.results and not by_index(self.call)

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
    prepare: Callable[[], None] | None = None
    """Function that brings the engine's memory up to date before the operations run; None where they need nothing."""
    operations: list[Operation] = field(default_factory=list)
    """Operations in the order in which they ran."""
    call: NotedCall | None = None
    """Call that ends the stage; None for the last one."""


class Tracer(TorchDispatchMode):
    """Notes what runs within it.

    Args:
        engine: whose state is read.
    """

    def __init__(self, engine: Engine) -> None:
        super().__init__()
        self.stages = [Stage()]
        """Stages so far; the last one is still open."""
        self.refusal = ""
        """What no trace can repeat; empty if nothing."""
        self.incomplete = False
        """True if the step made memory that later steps use, so that only its next trace may be replayed."""
        self._engine = engine
        self.paused = False
        """True while nothing is noted, as within a call to the engine."""

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
        # Python would branch on the value, and a replay could not.
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
        # One read per stage suffices: the state changes only with the call that ends it.
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
        if call.owner is self._engine:
            call = self._led(call)
        with self._silence():
            on_host = by_index(call)
            if on_host and self._engine.device.type != "cpu":
                self.refusal = f"{type(call.owner).__name__}'s {call.name} takes no mask"
            # Measurements of a traced step keep their memory, which later stages read in every replay.
            if call.kind.measures:
                result = call.function(**{**call.arguments, **({"env_ids": None} if on_host else {})})
                result = _kept(result)
                noted = NotedCall(call, _fields(result))
            else:
                result, noted = None, NotedCall(call, [])
                noted.repeat(call.arguments)
        # The stage ends here: what follows sees the state after the call.
        self.stages[-1].call = noted
        self.stages.append(Stage())
        return result

    def _led(self, call: EngineCall) -> EngineCall:
        """Note the operations that a call of the engine's begins with; returns what is left of it."""
        with self._silence():
            lead = self._engine.capture.lead(call.name)
            if lead is None:
                return call
            lead.prepare()
        self.stages[-1].prepare = lead.prepare
        lead.operations()
        return dataclasses.replace(call, function=lead.rest)

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
    """Return True if environments are given by a mask that the method does not take, so that the mask must be read."""
    return is_mask(call.arguments.get("env_ids")) and call.name not in call.owner.capture.takes_masks


def _fields(measured: Any) -> list[Tensor]:
    """The tensors of what a call gave: a tensor, a dataclass of them, or nothing."""
    if dataclasses.is_dataclass(measured):
        return [value for f in dataclasses.fields(measured) if (value := getattr(measured, f.name)) is not None]
    return [] if measured is None else [measured]


def _kept(measured: Any) -> Any:
    """Return a copy."""
    if isinstance(measured, Tensor):
        return measured.clone()
    names = [f.name for f in dataclasses.fields(measured) if getattr(measured, f.name) is not None]
    return dataclasses.replace(measured, **{name: getattr(measured, name).clone() for name in names})


def _decides(function: Any, arguments: tuple[Any, ...]) -> bool:
    """Return True if Python sees values of an operation's tensors, or shapes that depend on them."""
    if function is torch.ops.aten.index.Tensor:
        return any(index is not None and index.dtype == torch.bool for index in arguments[1])
    return any(tag in function.tags for tag in _DECIDING)


def _comes_from_host(taken: Any, result: Any) -> bool:
    tensors = tensors_of(taken)
    on_device = isinstance(result, Tensor) and result.device.type != "cpu"
    return on_device and bool(tensors) and all(tensor.device.type == "cpu" for tensor in tensors)


def _without_copy(function: Any, arguments: tuple[Any, ...]) -> tuple[Any, ...]:
    """Return the arguments of an operation, a number that is written by index moved to the device of its target.

    Torch would copy it to the device each time. What is written by mask is given with the launch, and must stay.
    """
    if function is not torch.ops.aten.index_put_.default:
        return arguments
    target, indices, value, *rest = arguments
    if value.dim() or any(index is not None and index.dtype == torch.bool for index in indices):
        return arguments
    return (target, indices, value.to(target.device), *rest)


Build = Callable[[fx.GraphModule, list[Tensor], bool], Callable[..., Sequence[Tensor]]]


class CapturedTrace:
    """A traced step, to be run again.

    Each tensor that one stage makes and a later one takes has a slot in a list, so that a run looks nothing up.

    Args:
        engine: that was used.
        stages: as a :class:`Tracer` noted them.
        outputs: tensors of the traced step; running the trace returns their new values, which hold until the next run.
        build: makes a stage's graph and the tensors that it takes, always these or others like them, into a function.
    """

    def __init__(
        self,
        engine: Engine,
        stages: Sequence[Stage],
        outputs: Sequence[Tensor],
        build: Build,
    ) -> None:
        self._engine = engine
        # Memory that existed before the step is read again in each replay; the rest is passed by slots.
        memory = _Memory(stages)
        # Tensors hash by identity, and the stages hold them, so that none is taken for another.
        maker = {tensor: number for number, stage in enumerate(stages) for tensor in _results(stage)}
        wanted: list[dict[Tensor, None]] = [{} for _ in stages]
        for tensor in outputs:
            wanted[-1 if memory.lasts(tensor) else maker[tensor]][tensor] = None
        for number, stage in enumerate(stages):
            taken = [(number, t) for op in stage.operations for t in tensors_of((op.arguments, op.keywords))]
            # The call comes after the operations.
            taken += [(number + 1, t) for t in (() if stage.call is None else stage.call.taken)]
            for place, tensor in taken:
                made = maker.get(tensor, place)
                if made < place and not memory.lasts(tensor):
                    wanted[made][tensor] = None
        slots: dict[Tensor, int] = {}
        for own in wanted:
            for tensor in own:
                slots.setdefault(tensor, len(slots))
        self._values: list[Tensor] = list(slots)
        self._outputs = [slots[tensor] for tensor in outputs]
        self._stages = [
            _BuiltStage(stage, memory, list(own), slots, build) for stage, own in zip(stages, wanted, strict=True)
        ]

    def __call__(self) -> tuple[Tensor, ...]:
        engine, values = self._engine, self._values
        for stage in self._stages:
            stage.run(engine, values)
        return tuple([values[slot] for slot in self._outputs])


@dataclass(frozen=True)
class _Slot:
    """Argument of a call that an earlier stage makes."""

    number: int


class _Memory:
    """Tensors that outlast a step, found by the memory that they occupy."""

    def __init__(self, stages: Sequence[Stage]) -> None:
        self._lasting: set[int] = set()
        made: set[int] = set()
        for stage in stages:
            for operation in stage.operations:
                taken = {_address(t) for t in tensors_of((operation.arguments, operation.keywords))}
                self._lasting |= taken - made
                made |= {_address(t) for t in tensors_of(operation.result)} - self._lasting

    def lasts(self, tensor: Tensor) -> bool:
        """Return True if the tensor occupies memory that existed before the step."""
        return _address(tensor) in self._lasting


class _BuiltStage:
    """One stage, ready to run."""

    def __init__(
        self,
        stage: Stage,
        memory: _Memory,
        wanted: list[Tensor],
        slots: Mapping[Tensor, int],
        build: Build,
    ) -> None:
        self._reads = tuple(stage.reads.items())
        self._settles = bool(stage.expressed)
        self._prepare = stage.prepare
        self._results = [slots[tensor] for tensor in wanted]
        graph = _StageGraph(stage, memory, wanted)
        self._inputs = graph.inputs
        self._passed = [(position, slots[tensor]) for position, tensor in graph.passed]
        some = stage.operations or wanted
        self._function = build(graph.module, graph.inputs, not graph.passed) if some else _nothing
        self._call: Callable[..., Any] | None = None
        # A call that gives nothing is made without looking at its arguments.
        self._plain = stage.call is not None and stage.call.is_plain
        if stage.call is not None:
            self._call = stage.call.call.function if self._plain else stage.call.repeat
        # Arguments of the call, with slots in the place of tensors that this stage or an earlier one makes
        self._arguments: dict[str, Any] = {}
        if stage.call is not None:
            self._arguments = {
                name: tree_map_only(Tensor, lambda t: _Slot(slots[t]) if t in slots else t, argument)
                for name, argument in stage.call.call.arguments.items()
            }
        self._filled = [name for name, own in self._arguments.items() if _has_slots(own)]

    def run(self, engine: Engine, values: list[Tensor]) -> None:
        """Run the stage, and its call."""
        # Expressions read the engine's memory directly, so it must be current before the operations run.
        if self._settles:
            engine.capture.settle()
        if self._prepare is not None:
            self._prepare()
        for name, taken in self._reads:
            if (value := getattr(engine, name)) is not taken:
                taken.copy_(value)  # the engine hands out another tensor each time
        inputs = self._inputs
        for position, slot in self._passed:
            inputs[position] = values[slot]
        for slot, value in zip(self._results, self._function(*inputs), strict=True):
            values[slot] = value
        if self._call is not None:
            given = self._arguments
            if self._filled:
                given = given.copy()
                for name in self._filled:
                    given[name] = _filled(given[name], values)
            if self._plain:
                self._call(**given)
            else:
                self._call(given)


def _has_slots(argument: Any) -> bool:
    return any(isinstance(leaf, _Slot) for leaf in tree_leaves(argument))


def _filled(argument: Any, values: list[Tensor]) -> Any:
    if isinstance(argument, _Slot):
        return values[argument.number]
    return tree_map_only(_Slot, lambda slot: values[slot.number], argument)


class _StageGraph:
    """A stage's operations as a graph whose inputs share no memory with each other.

    Where several tensors lie in the same memory, the input is that memory as a whole, and they are views made of it.
    """

    def __init__(self, stage: Stage, memory: _Memory, wanted: list[Tensor]) -> None:
        self.inputs: list[Tensor] = []
        self.passed: list[tuple[int, Tensor]] = []
        """Inputs that an earlier stage made, with their positions."""
        self._graph = fx.Graph()
        self._nodes: dict[Tensor, fx.Node] = {}
        self._add_inputs(stage, memory, wanted)
        for operation in stage.operations:
            self._add(operation)
        outputs = [self._nodes[tensor] for tensor in wanted]
        copied = [
            self._graph.call_function(torch.ops.aten.clone.default, (node,)) if memory.lasts(tensor) else node
            for node, tensor in zip(outputs, wanted, strict=True)
        ]
        self._graph.output(tuple(copied))
        self.module = fx.GraphModule({}, self._graph)

    def _add_inputs(self, stage: Stage, memory: _Memory, wanted: list[Tensor]) -> None:
        groups: dict[int, dict[Tensor, None]] = {}
        made: set[Tensor] = set()
        written = {_address(tensor) for operation in stage.operations for tensor in _written(operation)}

        def take(tensors: list[Tensor]) -> None:
            for tensor in tensors:
                if tensor not in made:
                    groups.setdefault(_address(tensor), {})[tensor] = None

        for operation in stage.operations:
            take(tensors_of((operation.arguments, operation.keywords)))
            made |= set(tensors_of(operation.result))
        take(wanted)
        shared: list[tuple[fx.Node, dict[Tensor, None]]] = []
        for address, group in groups.items():
            first = next(iter(group))
            # The usual case: no other tensor shares the memory, so it is an input as it is. So are several that an
            # earlier stage made, where none is written: what shares their memory makes no difference then.
            if len(group) == 1 or (address not in written and not memory.lasts(first)):
                for tensor in group:
                    self._nodes[tensor] = self._placeholder(tensor)
                    self._nodes[tensor].meta["shape"] = tensor.shape
                    if not memory.lasts(tensor):
                        self.passed.append((len(self.inputs) - 1, tensor))
                continue
            if not memory.lasts(first) or len({tensor.dtype for tensor in group}) > 1:
                raise NotTraceable("tensors made in one stage share memory that the next one writes")
            whole = torch.empty(0, dtype=first.dtype, device=first.device).set_(first.untyped_storage())
            shared.append((self._placeholder(whole), group))
        for node, group in shared:
            for tensor in group:
                view = (node, list(tensor.shape), list(tensor.stride()), tensor.storage_offset())
                self._nodes[tensor] = self._graph.call_function(torch.ops.aten.as_strided.default, view)
                self._nodes[tensor].meta["shape"] = tensor.shape

    def _placeholder(self, tensor: Tensor) -> fx.Node:
        """Return the node of a new input."""
        self.inputs.append(tensor)
        return self._graph.placeholder(f"memory_{len(self.inputs) - 1}")

    def _add(self, operation: Operation) -> None:
        arguments, keywords = tree_map(self._node_of, (operation.arguments, operation.keywords))
        node = self._graph.call_function(operation.function, arguments, keywords)
        if isinstance(operation.result, Tensor):
            node.meta["shape"] = operation.result.shape
            self._nodes.setdefault(operation.result, node)  # one that was written in place keeps its name
        else:
            for index, part in enumerate(operation.result or ()):
                if isinstance(part, Tensor):
                    self._nodes.setdefault(part, self._graph.call_function(operator.getitem, (node, index)))

    def _node_of(self, argument: Any) -> Any:
        return self._nodes[argument] if isinstance(argument, Tensor) else argument


def _nothing() -> tuple[()]:
    return ()


def _written(operation: Operation) -> list[Tensor]:
    """Tensors whose memory an operation writes, as its schema tells."""
    parameters = operation.function._schema.arguments
    given = [
        operation.arguments[place] if place < len(operation.arguments) else operation.keywords.get(parameter.name)
        for place, parameter in enumerate(parameters)
        if parameter.alias_info is not None and parameter.alias_info.is_write
    ]
    return tensors_of(given)


def _results(stage: Stage) -> list[Tensor]:
    return [tensor for operation in stage.operations for tensor in tensors_of(operation.result)]


def _address(tensor: Tensor) -> int:
    """Return the address of the tensor's memory; a unique number for an empty tensor."""
    return tensor.untyped_storage().data_ptr() or -id(tensor)
