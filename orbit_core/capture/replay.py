"""Functions without their Python: traced once per state of a schedule, then replayed, compiled or recorded."""

from __future__ import annotations

import math
import types
from collections.abc import Callable, Hashable, Iterator, Sequence
from contextlib import contextmanager
from contextvars import ContextVar
from typing import Any, TypeVar

import torch
from torch import Tensor, fx

from orbit_core.capture.python_state import PythonState, frozen_by_trace
from orbit_core.capture.trace import CapturedTrace, NotTraceable, Tracer
from orbit_core.interfaces import ConfigurationError, World
from orbit_core.interfaces.capture import Schedule

# Compiling a traced step with torch's inductor: many small operations become a few loops ------------------------------

_REMEDY = "or leave compile out"


def check_compiler(device: torch.device) -> None:
    """Look for what inductor compiles with.

    Raises:
        ConfigurationError: it is not there; says what to install.
    """
    if device.type == "cpu":
        from torch._inductor.cpp_builder import get_cpp_compiler
        from torch._inductor.exc import InvalidCxxCompiler

        try:
            get_cpp_compiler()
        except (InvalidCxxCompiler, RuntimeError):
            raise ConfigurationError(
                f"compile needs a C++ compiler and found none: install g++ or clang, name one in CXX, {_REMEDY}"
            ) from None
        return
    from torch.utils._triton import has_triton

    if not has_triton():
        raise ConfigurationError(f"compile needs Triton on device '{device}': pip install triton, {_REMEDY}")


def compiled(graph: fx.GraphModule, inputs: list[Tensor], fixed: bool) -> Callable[..., Sequence[Tensor]]:
    """The graph, for inputs of the same shapes, as compiled code; what inductor cached on disk is taken from there.

    Args:
        graph: of operations.
        inputs: that it takes; a tensor on another device than the rest is replaced by a copy on theirs.
        fixed: whether it always takes these very tensors. What it gives may then be the same tensors each time.

    Raises:
        ConfigurationError: inductor fails.
    """
    _spell_out_products(graph)
    try:
        with torch.no_grad():
            on_cpu = all(tensor.device.type == "cpu" for tensor in inputs)
            return _on_cpu(graph, inputs, fixed) if on_cpu else _on_gpu(graph, inputs)
    except Exception as error:  # of many kinds: inductor's own, the compiler's, the operating system's
        first = next(iter(str(error).splitlines()), "")
        raise ConfigurationError(
            f"the step could not be compiled, for {type(error).__name__}: {first}; check the compiler, {_REMEDY}"
        ) from error


def _shapes_of(inputs: list[Tensor]) -> tuple[Any, list[Any]]:
    """Return a mode, and stand-ins in it with shapes alone: only for those does inductor look code up on disk."""
    from torch._subclasses import FakeTensorMode
    from torch.fx.experimental.symbolic_shapes import ShapeEnv

    mode = FakeTensorMode(shape_env=ShapeEnv(), static_shapes=True, allow_non_fake_inputs=True)
    return mode, [mode.from_tensor(tensor) for tensor in inputs]


def _on_gpu(graph: fx.GraphModule, inputs: list[Tensor]) -> Callable[..., Sequence[Tensor]]:
    # Numbers of Python's lie on the host, from where compiled code would copy them to the device each time.
    device = next(tensor.device for tensor in inputs if tensor.device.type != "cpu")
    inputs[:] = [tensor.to(device) if tensor.dim() == 0 else tensor for tensor in inputs]
    for node in graph.graph.nodes:
        if "device" in node.kwargs:
            node.kwargs = {**node.kwargs, "device": device}
    graph.recompile()
    return _by_inductor(graph, inputs)


def _by_inductor(graph: fx.GraphModule, inputs: list[Tensor]) -> Callable[..., Sequence[Tensor]]:
    """Return the graph as inductor compiles it on any device, with what it writes to its inputs."""
    import torch._inductor as inductor

    return inductor.compile(graph, _shapes_of(inputs)[1])  # pyright: ignore[reportReturnType]


def _on_cpu(graph: fx.GraphModule, inputs: list[Tensor], fixed: bool) -> Callable[..., Sequence[Tensor]]:
    from torch._guards import TracingContext, tracing
    from torch._inductor import config
    from torch._inductor.compile_fx import compile_fx_inner
    from torch._inductor.decomposition import select_decomp_table
    from torch.fx.experimental.proxy_tensor import make_fx

    functional = torch.func.functionalize(graph, remove="mutations")
    mode, fakes = _shapes_of(inputs)
    pure = make_fx(functional, decomposition_table=select_decomp_table(), tracing_mode="fake")(*fakes)
    # Threads cost more than they save on a step's small tensors, and the engine needs the cores. Sizes never change.
    with tracing(TracingContext(mode)), config.patch({"cpp.threads": 1, "size_asserts": False}):
        # The inner entry point: the outer one wraps the code in guards that cost more than the kernels.
        code: Any = compile_fx_inner(pure, fakes)
    call = code.current_callable
    return (_launches(call, inputs) if fixed else None) or (lambda *tensors: call(list(tensors)))


# Names in inductor's code that only make room for what its kernels write
_OF_MEMORY = {"clear", "empty_strided_cpu", "reinterpret_tensor", "torch"}


def _launches(call: Any, inputs: list[Tensor]) -> Callable[..., Sequence[Tensor]] | None:
    """The kernels that inductor's code calls, on the memory of one call; None where it does more than call kernels.

    For a step's few numbers the code around the kernels takes several times as long as they do.
    """
    function = getattr(call, "__func__", call)
    names = {name for name in function.__code__.co_names if not isinstance(getattr(torch, name, None), torch.dtype)}
    kernels = {name for name in names if name.startswith("cpp_fused")}
    if names - kernels - _OF_MEMORY:
        return None
    launches: list[tuple[Callable[..., None], tuple[Any, ...]]] = []

    def noting(kernel: Callable[..., None]) -> Callable[..., None]:
        return lambda *arguments: launches.append((kernel, arguments))

    # A copy of the function with its own globals: inductor's module stays as it is.
    module = function.__globals__
    noted = {**module, **{name: noting(module[name]) for name in kernels}}
    copy = types.FunctionType(function.__code__, noted, function.__name__, function.__defaults__, function.__closure__)
    owner = getattr(call, "__self__", None)
    outputs = copy(list(inputs)) if owner is None else copy(owner, list(inputs))

    def launch(*_: Tensor) -> Sequence[Tensor]:
        for kernel, arguments in launches:
            kernel(*arguments)
        return outputs

    return launch


_FEW_NUMBERS = 1024


def _spell_out_products(graph: fx.GraphModule) -> None:
    """Products of small matrices become multiplications and sums, which melt into the loops around them."""
    aten = torch.ops.aten
    for node in list(graph.graph.nodes):
        if node.target not in (aten.mm.default, aten.addmm.default) or node.kwargs:
            continue
        left, right = node.args[-2:]
        # Large products stay: BLAS is faster than a fused loop there.
        if min(math.prod(side.meta["shape"]) for side in (left, right)) > _FEW_NUMBERS:
            continue
        with graph.graph.inserting_before(node):

            def call(function: Any, *arguments: Any) -> fx.Node:
                return graph.graph.call_function(function, arguments)

            products = call(
                aten.mul.Tensor, call(aten.unsqueeze.default, left, -1), call(aten.unsqueeze.default, right, 0)
            )
            result = call(aten.sum.dim_IntList, products, [1])
            if node.target is aten.addmm.default:
                result = call(aten.add.Tensor, result, node.args[0])
        node.replace_all_uses_with(result)
        graph.graph.erase_node(node)
    graph.recompile()


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
        """Replays the operations; None until they are traced."""
        self.trace: Callable[[], tuple[Tensor, ...]] | None = None
        """Traced operations that are not recorded, to be part of a larger recording; None until they are traced."""
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
                self.trace = CapturedTrace(world.engine, tracer.stages, outputs, self._build)
                self.replay = _recorded(self.trace, world.engine.capture.record)
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
_Result = TypeVar("_Result")


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
        # Keyed by all that Python decides, so that a replay never runs a branch that Python would not take.
        key = self._key()
        if (known := self._known.get(key)) is not None:
            return self._run(known, CapturedFunction.__call__)
        before = [schedule.count for schedule in self._schedules]
        function = self._capture()
        outputs = function()
        self.refusal = function.refusal
        if function.replay is not None:
            steps = tuple(schedule.count - old for schedule, old in zip(self._schedules, before, strict=True))
            self._known[key] = function, self._key(), steps
        return outputs

    def repeat(self, run: Callable[[CapturedFunction], _Result]) -> _Result:
        """Return what ``run`` makes of the function of the present key, which was captured, and count its steps."""
        return self._run(self._known[self._key()], run)

    def _run(
        self, known: tuple[CapturedFunction, _Keys, tuple[int, ...]], run: Callable[[CapturedFunction], _Result]
    ) -> _Result:
        function, following, steps = known
        outputs = run(function)
        for schedule, own, count in zip(self._schedules, following, steps, strict=True):
            schedule.move(own, count)
        return outputs

    def _key(self) -> _Keys:
        return tuple([schedule.key for schedule in self._schedules])


Compose = Callable[[Callable[[], tuple[Tensor, ...]]], None]
"""Function that calls captured operations once, among operations of its own."""


class ComposedFunction:
    """Captured operations among others, together one recording of the engine for each key of their schedules.

    Args:
        world: whose engine records.
        scheduled: captured operations.
        compose: what is recorded. It works on tensors of the engine's device and does not wait for it, writes results
            in place, and draws no random numbers of torch's, whose generator a recording of the engine cannot hold.
    """

    def __init__(self, world: World, scheduled: ScheduledFunction, compose: Compose) -> None:
        self._world, self._scheduled, self._compose = world, scheduled, compose
        # The function that each recording was made of, because a step that was captured again needs another.
        self._recordings: dict[CapturedFunction, Callable[[], None]] = {}

    def __call__(self) -> None:
        """Run once. The operations of the present key must have been captured."""
        self._scheduled.repeat(self._replay)

    def _replay(self, function: CapturedFunction) -> None:
        recording = self._recordings.get(function)
        if recording is None:
            current = self._scheduled.functions
            self._recordings = {known: made for known, made in self._recordings.items() if known in current}
            trace = function.trace
            assert trace is not None
            recording = self._world.engine.capture.record(lambda: self._compose(trace))
            self._recordings[function] = recording
        recording()
