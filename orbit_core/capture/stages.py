"""A traced step put together again: a function of each stage's operations, and calls between them."""

from __future__ import annotations

import operator
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import torch
from torch import Tensor, fx
from torch.utils._pytree import tree_leaves, tree_map, tree_map_only

from orbit_core.capture.trace import NotTraceable, Operation, Stage, tensors_of
from orbit_core.interfaces import Engine

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
    """Which tensors stay when a step is over, told by the memory that they lie in."""

    def __init__(self, stages: Sequence[Stage]) -> None:
        self._lasting: set[int] = set()
        made: set[int] = set()
        for stage in stages:
            for operation in stage.operations:
                taken = {_address(t) for t in tensors_of((operation.arguments, operation.keywords))}
                self._lasting |= taken - made
                made |= {_address(t) for t in tensors_of(operation.result)} - self._lasting

    def lasts(self, tensor: Tensor) -> bool:
        """Whether the tensor lies in memory that was there before the step."""
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
        self._results = [slots[tensor] for tensor in wanted]
        graph = _StageGraph(stage, memory, wanted)
        self._inputs = graph.inputs
        self._passed = [(position, slots[tensor]) for position, tensor in graph.passed]
        some = stage.operations or wanted
        self._function = build(graph.module, graph.inputs, not graph.passed) if some else _nothing
        self._call = stage.call
        self._arguments: dict[str, Any] = {}
        """Arguments of the call, with slots in the place of tensors that this stage or an earlier one makes."""
        if stage.call is not None:
            self._arguments = {
                name: tree_map_only(Tensor, lambda t: _Slot(slots[t]) if t in slots else t, argument)
                for name, argument in stage.call.call.arguments.items()
            }
        self._filled = [name for name, own in self._arguments.items() if _has_slots(own)]

    def run(self, engine: Engine, values: list[Tensor]) -> None:
        """Run the stage, and its call."""
        if self._settles:
            engine.capture.settle()
        for name, taken in self._reads:
            if (value := getattr(engine, name)) is not taken:
                taken.copy_(value)  # the engine hands out another tensor each time
        inputs = self._inputs
        for position, slot in self._passed:
            inputs[position] = values[slot]
        for slot, value in zip(self._results, self._function(*inputs), strict=True):
            values[slot] = value
        if self._call is not None:
            given = self._arguments.copy()
            for name in self._filled:
                given[name] = _filled(given[name], values)
            self._call.repeat(given)


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

        def take(tensors: list[Tensor]) -> None:
            for tensor in tensors:
                if tensor not in made:
                    groups.setdefault(_address(tensor), {})[tensor] = None

        for operation in stage.operations:
            take(tensors_of((operation.arguments, operation.keywords)))
            made |= set(tensors_of(operation.result))
        take(wanted)
        placeholders = [self._graph.placeholder(f"memory_{i}") for i in range(len(groups))]
        for node, group in zip(placeholders, groups.values(), strict=True):
            first = next(iter(group))
            if len(group) == 1:
                self._nodes[first] = node
                node.meta["shape"] = first.shape
                if not memory.lasts(first):
                    self.passed.append((len(self.inputs), first))
                self.inputs.append(first)
                continue
            if not memory.lasts(first) or len({tensor.dtype for tensor in group}) > 1:
                raise NotTraceable("tensors made in one stage share memory in the next")
            self.inputs.append(torch.empty(0, dtype=first.dtype, device=first.device).set_(first.untyped_storage()))
            for tensor in group:
                view = (node, list(tensor.shape), list(tensor.stride()), tensor.storage_offset())
                self._nodes[tensor] = self._graph.call_function(torch.ops.aten.as_strided.default, view)
                self._nodes[tensor].meta["shape"] = tensor.shape

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


def _results(stage: Stage) -> list[Tensor]:
    return [tensor for operation in stage.operations for tensor in tensors_of(operation.result)]


def _address(tensor: Tensor) -> int:
    """Address of the memory that the tensor lies in; for an empty tensor, a number of its own."""
    return tensor.untyped_storage().data_ptr() or -id(tensor)
