"""What a step does, as data: tensor operations in stages, between calls to the engine.

A :class:`Tracer` watches a step while it runs. Each operation of torch and each use of the engine is noted, with the
tensors that they took; what comes of it, a :class:`Trace`, does the same to the same memory without the Python around.
"""

from __future__ import annotations

import operator
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from functools import partial
from typing import Any

import torch
from torch import Tensor, fx
from torch.utils._python_dispatch import TorchDispatchMode
from torch.utils._pytree import tree_leaves, tree_map

from orbit_core.dynamics.indexing import is_mask
from orbit_core.interfaces import Engine

READS = (
    "joint_positions", "joint_velocities", "joint_efforts", "link_poses", "link_velocities", "contact_forces",
    "joint_wrenches",
)  # fmt: skip
"""What a trace may read of an engine."""
CALLS: Mapping[str, tuple[int, ...]] = {
    "step": (), "reset": (), "write_joint_state": (1, 2), "write_root_state": (1, 2), "set_wrenches": (1,),
    "set_masses": (1,), "set_centers_of_mass": (1,), "set_friction": (1,), "set_drive_gains": (1, 2),
    "set_gravity": (0,),
}  # fmt: skip
"""What a trace may call of an engine, and which arguments have a row for each environment of the last argument."""
_DECIDING = (torch.Tag.data_dependent_output, torch.Tag.dynamic_output_shape)


Build = Callable[[fx.GraphModule, list[Tensor], bool], Callable[..., Sequence[Tensor]]]


class NotTraceable(Exception):
    """The step does what no trace can repeat; says what."""


@dataclass(frozen=True, eq=False)
class Operation:
    """One operation of torch with the very tensors that it took and gave."""

    function: Any
    arguments: tuple[Any, ...]
    keywords: dict[str, Any]
    result: Any


@dataclass(eq=False)
class Stage:
    """Reads of the engine, then operations, then one call to the engine."""

    reads: dict[str, Tensor] = field(default_factory=dict)
    """What was read, and the tensor that the operations took."""
    expressed: dict[str, Tensor] = field(default_factory=dict)
    """What was read by way of operations."""
    operations: list[Operation] = field(default_factory=list)
    call: tuple[str, tuple[Any, ...]] | None = None


class Tracer(TorchDispatchMode):
    """Notes what runs within it."""

    def __init__(self) -> None:
        super().__init__()
        self.stages = [Stage()]
        self.refusal = ""
        """What no trace can repeat; empty if nothing."""
        self._paused = False

    @contextmanager
    def tracing(self, engine: Engine) -> Iterator[None]:
        """Note torch's operations, and the uses of ``engine`` in the place of the operations within them."""
        own_type = type(engine)
        reads = {name: property(self._noting_read(name, getattr(own_type, name).fget)) for name in READS}
        calls = {name: self._noting_call(name, getattr(own_type, name)) for name in CALLS}
        engine.__class__ = type(own_type.__name__, (own_type,), {**reads, **calls})
        try:
            with self:
                yield
        finally:
            engine.__class__ = own_type

    def __torch_dispatch__(
        self, func: Any, types: Any, args: tuple[Any, ...] = (), kwargs: dict[str, Any] | None = None
    ) -> Any:
        keywords = kwargs or {}
        if self._paused:
            return func(*args, **keywords)
        if _decides(func, args):
            self.refusal = f"{func} looks at a tensor's values"
        result = func(*args, **keywords)
        if _comes_from_host((args, keywords), result):
            return result  # a constant that Python made: its copy on the device is one too
        self.stages[-1].operations.append(Operation(func, _without_copy(func, args), keywords, result))
        return result

    def _noting_read(self, name: str, read: Callable[[Engine], Tensor]) -> Callable[[Engine], Tensor]:
        def noted(engine: Engine) -> Tensor:
            if self._paused:
                return read(engine)
            # Either shows the state since the last call, whatever was computed meanwhile.
            reads, expressed = self.stages[-1].reads, self.stages[-1].expressed
            if name in reads or name in expressed:
                return reads[name] if name in reads else expressed[name]
            with self._silence():
                engine.settle()
            value = engine.expression(name)
            if value is not None:
                return expressed.setdefault(name, value)
            with self._silence():
                return reads.setdefault(name, read(engine))

        return noted

    def _noting_call(self, name: str, call: Callable[..., None]) -> Callable[..., None]:
        def noted(engine: Engine, *arguments: Any) -> None:
            with self._silence():
                if _by_index(engine, name, arguments) and engine.device.type != "cpu":
                    self.refusal = f"the engine's {name} takes no mask"
                _call(engine, name, partial(call, engine), arguments)
            if not self._paused:
                self.stages[-1].call = (name, arguments)
                self.stages.append(Stage())

        return noted

    @contextmanager
    def _silence(self) -> Iterator[None]:
        before, self._paused = self._paused, True
        try:
            yield
        finally:
            self._paused = before


class Trace:
    """A step that was traced, to be run again. Tensors are told apart by their addresses, while the stages hold them.

    Args:
        engine: that was used.
        stages: as a :class:`Tracer` noted them.
        outputs: tensors of the traced step; running the trace gives their new values, which hold until the next run.
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
        maker = {id(t): number for number, stage in enumerate(stages) for t in _results(stage)}
        wanted: list[dict[int, Tensor]] = [{} for _ in stages]
        self._outputs = [id(tensor) for tensor in outputs]
        for tensor in outputs:
            wanted[-1 if memory.lasts(tensor) else maker[id(tensor)]][id(tensor)] = tensor
        for number, stage in enumerate(stages):
            taken = [(number, t) for op in stage.operations for t in _tensors((op.arguments, op.keywords))]
            taken += [(number + 1, t) for t in _tensors(stage.call)]  # the call comes after the operations
            for place, tensor in taken:
                made = maker.get(id(tensor), place)
                if made < place and not memory.lasts(tensor):
                    wanted[made][id(tensor)] = tensor
        self._stages = [
            _BuiltStage(stage, memory, list(need.values()), build) for stage, need in zip(stages, wanted, strict=True)
        ]

    def __call__(self) -> tuple[Tensor, ...]:
        engine, values = self._engine, {}
        for stage in self._stages:
            stage.run(engine, values)
        return tuple([values[name] for name in self._outputs])


class _Memory:
    """Which tensors stay when a step is over, told by the memory that they lie in."""

    def __init__(self, stages: Sequence[Stage]) -> None:
        self._lasting: set[int] = set()
        made: set[int] = set()
        for stage in stages:
            for operation in stage.operations:
                taken = {_address(t) for t in _tensors((operation.arguments, operation.keywords))}
                self._lasting |= taken - made
                made |= {_address(t) for t in _tensors(operation.result)} - self._lasting

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
        build: Build,
    ) -> None:
        self._reads = tuple(stage.reads.items())
        self._settles = bool(stage.expressed)
        self._call = stage.call
        self._results = [id(tensor) for tensor in wanted]
        graph = _StageGraph(stage, memory, wanted)
        self._inputs = graph.inputs
        self._passed = graph.passed
        some = stage.operations or wanted
        self._function = build(graph.module, graph.inputs, not graph.passed) if some else _nothing

    def run(self, engine: Engine, values: dict[int, Tensor]) -> None:
        if self._settles:
            engine.settle()
        for name, taken in self._reads:
            if (value := getattr(engine, name)) is not taken:
                taken.copy_(value)  # the engine hands out another tensor each time
        inputs = self._inputs
        for position, name in self._passed:
            inputs[position] = values[name]
        values.update(zip(self._results, self._function(*inputs), strict=True))
        if self._call is not None:
            name, arguments = self._call
            given = tuple([values.get(id(a), a) for a in arguments])
            _call(engine, name, getattr(engine, name), given)


class _StageGraph:
    """A stage's operations as a graph whose inputs share no memory with each other.

    Where several tensors lie in the same memory, the input is that memory as a whole, and they are views made of it.
    """

    def __init__(self, stage: Stage, memory: _Memory, wanted: list[Tensor]) -> None:
        self.inputs: list[Tensor] = []
        self.passed: list[tuple[int, int]] = []
        """Position and name of the inputs that an earlier stage made."""
        self._graph = fx.Graph()
        self._nodes: dict[int, fx.Node] = {}
        self._add_inputs(stage, memory, wanted)
        for operation in stage.operations:
            self._add(operation)
        outputs = [self._nodes[id(tensor)] for tensor in wanted]
        copied = [
            self._graph.call_function(torch.ops.aten.clone.default, (node,)) if memory.lasts(tensor) else node
            for node, tensor in zip(outputs, wanted, strict=True)
        ]
        self._graph.output(tuple(copied))
        self.module = fx.GraphModule({}, self._graph)

    def _add_inputs(self, stage: Stage, memory: _Memory, wanted: list[Tensor]) -> None:
        groups: dict[int, dict[int, Tensor]] = {}
        made: set[int] = set()

        def take(tensors: list[Tensor]) -> None:
            for tensor in tensors:
                if id(tensor) not in made:
                    groups.setdefault(_address(tensor), {})[id(tensor)] = tensor

        for operation in stage.operations:
            take(_tensors((operation.arguments, operation.keywords)))
            made |= {id(tensor) for tensor in _tensors(operation.result)}
        take(wanted)
        placeholders = [self._graph.placeholder(f"memory_{i}") for i in range(len(groups))]
        for node, group in zip(placeholders, groups.values(), strict=True):
            first = next(iter(group.values()))
            if len(group) == 1:
                self._nodes[id(first)] = node
                node.meta["shape"] = first.shape
                if not memory.lasts(first):
                    self.passed.append((len(self.inputs), id(first)))
                self.inputs.append(first)
                continue
            if not memory.lasts(first) or len({tensor.dtype for tensor in group.values()}) > 1:
                raise NotTraceable("tensors made in one stage share memory in the next")
            self.inputs.append(torch.empty(0, dtype=first.dtype, device=first.device).set_(first.untyped_storage()))
            for name, tensor in group.items():
                view = (node, list(tensor.shape), list(tensor.stride()), tensor.storage_offset())
                self._nodes[name] = self._graph.call_function(torch.ops.aten.as_strided.default, view)
                self._nodes[name].meta["shape"] = tensor.shape

    def _add(self, operation: Operation) -> None:
        arguments, keywords = tree_map(self._node_of, (operation.arguments, operation.keywords))
        node = self._graph.call_function(operation.function, arguments, keywords)
        if isinstance(operation.result, Tensor):
            node.meta["shape"] = operation.result.shape
            self._nodes.setdefault(id(operation.result), node)  # one that was written in place keeps its name
        else:
            for index, part in enumerate(operation.result or ()):
                if isinstance(part, Tensor):
                    self._nodes.setdefault(id(part), self._graph.call_function(operator.getitem, (node, index)))

    def _node_of(self, argument: Any) -> Any:
        return self._nodes[id(argument)] if isinstance(argument, Tensor) else argument


def _call(engine: Engine, name: str, call: Callable[..., None], arguments: tuple[Any, ...]) -> None:
    """Call the engine, with indices in the place of a mask where it takes none: to find them is to look at the mask."""
    if _by_index(engine, name, arguments):
        env_ids = arguments[-1].nonzero().squeeze(-1)
        if not len(env_ids):
            return
        rows = CALLS[name]
        arguments = tuple(a[env_ids] if i in rows and a is not None else a for i, a in enumerate(arguments[:-1]))
        arguments = (*arguments, env_ids)
    call(*arguments)


def _by_index(engine: Engine, name: str, arguments: tuple[Any, ...]) -> bool:
    """Whether the last argument is a mask that the method does not take."""
    return name != "step" and name not in engine.takes_masks and is_mask(arguments[-1])


def _nothing() -> tuple[()]:
    return ()


def _decides(function: Any, arguments: tuple[Any, ...]) -> bool:
    """Whether the values of an operation's tensors decide what Python sees of it."""
    if function is torch.ops.aten.index.Tensor:
        return any(index is not None and index.dtype == torch.bool for index in arguments[1])
    return any(tag in function.tags for tag in _DECIDING)


def _comes_from_host(taken: Any, result: Any) -> bool:
    tensors = _tensors(taken)
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


def _tensors(tree: Any) -> list[Tensor]:
    return [leaf for leaf in tree_leaves(tree) if isinstance(leaf, Tensor)]


def _results(stage: Stage) -> list[Tensor]:
    return [tensor for operation in stage.operations for tensor in _tensors(operation.result)]


def _address(tensor: Tensor) -> int:
    """Of the memory that the tensor lies in; an empty one has its own name for it."""
    return tensor.untyped_storage().data_ptr() or -id(tensor)
