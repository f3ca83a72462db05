"""Functions of a few numbers per environment as one kernel, built where a step is compiled.

Expressions become source text for a C++ compiler and for a GPU's, which share the arithmetic. On a CPU each variable
holds the numbers of several environments, next to each other in one register (GCC's and Clang's vector extensions); on
a GPU each thread has one environment. Results are row-major on a CPU, and column-major on a GPU, where neighbouring
threads write at once.
"""

from __future__ import annotations

import ctypes
import hashlib
import os
import subprocess
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import torch
from torch import Tensor
from torch.utils._python_dispatch import _disable_current_modes

from orbit_core.capture.replay import kernels_wanted
from orbit_core.interfaces.capture import Traceable, changes
from orbit_core.plugin_kit.scratch import ScratchFolder
from orbit_motion.fusion.operations import Expression, Unfusable, expressions

LANES = 8
"""Environments per register of a CPU: eight floats are 256 bits."""
ROWS = {"own": "({0})", "env": "({0}) / {1}", "part": "({0}) % {1}"}
"""Index of an input's row: one per environment and part, one per environment, or one per part in all environments."""
_READ_ON_CPU = (
    "    auto {row} = [&](int place) {{ V r; "
    "for (int i = 0; i < lanes; i++) r[i] = in_{row}[{which} * {width} + place]; return r; }};"
)
_READ_ON_GPU = "  auto {row} = [&](int place) {{ return in_{row}[{which} * {width} + place]; }};"
_FORMS = {
    "add": "{} + {}",
    "sub": "{} - {}",
    "mul": "{} * {}",
    "neg": "-{}",
    "reciprocal": "K(1.0f) / {}",
    "sqrt": "root({})",
    "sin": "sine({})",
    "cos": "cosine({})",
    "atan2": "angle({}, {})",
    "abs": "size({})",
    "min": "lesser({}, {})",
    "max": "greater({}, {})",
    "lt": "{} < {}",
    "le": "{} <= {}",
    "eq": "{} == {}",
    "and": "{} & {}",
    "or": "{} | {}",
    "not": "{} == 0",
    "where": "{} ? {} : {}",
}
_ON_CPU = """
#include <cmath>
typedef float V __attribute__((vector_size({bytes}), aligned(4)));
typedef int M __attribute__((vector_size({bytes}), aligned(4)));
static const int lanes = {lanes};
static inline V K(float x) {{ V r; for (int i = 0; i < lanes; i++) r[i] = x; return r; }}
#define EACH(name, call, ...) static inline V name(__VA_ARGS__) {{ \\
    V r; for (int i = 0; i < lanes; i++) r[i] = call; return r; }}
EACH(root, std::sqrt(x[i]), V x)
EACH(sine, std::sin(x[i]), V x)
EACH(cosine, std::cos(x[i]), V x)
EACH(angle, std::atan2(y[i], x[i]), V y, V x)
static inline V size(V x) {{ return x < 0.0f ? -x : x; }}
static inline V lesser(V a, V b) {{ return b < a ? b : a; }}
static inline V greater(V a, V b) {{ return a < b ? b : a; }}
extern "C" void fused({parameters}float* out, int count) {{
  for (int begin = 0; begin < count; begin += lanes) {{
    int at[lanes];
    for (int i = 0; i < lanes; i++) at[i] = begin + i < count ? begin + i : count - 1;
{rows}
    auto put = [&](int place, V x) {{ for (int i = 0; i < lanes; i++) out[at[i] * {given} + place] = x[i]; }};
{body}
  }}
}}
"""
_ON_GPU = """
typedef float V;
typedef int M;
__device__ inline V K(float x) {{ return x; }}
__device__ inline V root(V x) {{ return sqrtf(x); }}
__device__ inline V sine(V x) {{ return sinf(x); }}
__device__ inline V cosine(V x) {{ return cosf(x); }}
__device__ inline V angle(V y, V x) {{ return atan2f(y, x); }}
__device__ inline V size(V x) {{ return fabsf(x); }}
__device__ inline V lesser(V a, V b) {{ return b < a ? b : a; }}
__device__ inline V greater(V a, V b) {{ return a < b ? b : a; }}
extern "C" __global__ void fused({parameters}float* out, int count) {{
  int at = blockIdx.x * blockDim.x + threadIdx.x;
  if (at >= count) return;
{rows}
  auto put = [&](int place, V x) {{ out[place * count + at] = x; }};
{body}
}}
"""


@dataclass(frozen=True)
class Program:
    """Computation of one environment, or of one part of it: input rows and output expressions.

    Attributes:
        widths: numbers in each row of inputs, by the row's name, one of :data:`ROWS`.
        outputs: of the row that comes of them.
        parts: of an environment that have rows of their own, 1 or more.
        device: where it is to run.
    """

    widths: Mapping[str, int]
    outputs: Sequence[Expression]
    parts: int
    device: torch.device

    @property
    def on_cpu(self) -> bool:
        """True if the program is for a CPU."""
        return self.device.type == "cpu"

    def room(self, sizes: torch.Size) -> torch.Tensor:
        """Allocate output memory (*sizes, W) for W numbers per row, in the layout of the device."""
        if self.on_cpu:
            return torch.empty(*sizes, len(self.outputs))
        return torch.empty(len(self.outputs), *sizes, device=self.device).movedim(0, -1)

    def source(self) -> str:
        """Return source text of a function ``fused``; its arguments are pointers to input rows, output memory and a
        count.
        """
        on_cpu = self.on_cpu
        parameters = "".join(f"const float* in_{row}, " for row in self.widths)
        reads = [
            (_READ_ON_CPU if on_cpu else _READ_ON_GPU).format(
                row=row, width=width, which=ROWS[row].format("at[i]" if on_cpu else "at", self.parts)
            )
            for row, width in self.widths.items()
        ]
        sizes = {"given": len(self.outputs), "lanes": LANES, "bytes": 4 * LANES, "rows": "\n".join(reads)}
        frame = _ON_CPU if on_cpu else _ON_GPU
        return frame.format(body="\n".join(self._body()), parameters=parameters, **sizes)

    def operations(self) -> int:
        """Return the number of arithmetic operations per environment."""
        return sum(bool(expression.operands) for expression in _in_order(self.outputs))

    def _body(self) -> list[str]:
        names: dict[int, str] = {}
        lines: list[str] = []
        for expression in _in_order(self.outputs):
            if expression.constant:
                names[id(expression)] = _literal(expression)
                continue
            name = names[id(expression)] = f"t{len(names)}"
            kind = "M" if expression.is_bool else "V"
            lines.append(f"const {kind} {name} = {_text(expression, names)};")
        return lines + [f"put({place}, {names[id(x)]});" for place, x in enumerate(self.outputs)]


def _text(expression: Expression, names: dict[int, str]) -> str:
    if expression.operation == "element":
        row, place = expression.place
        return f"{row}({place})"
    return _FORMS[expression.operation].format(*(names[id(operand)] for operand in expression.operands))


def _literal(expression: Expression) -> str:
    if expression.is_bool:
        return "1" if expression.value else "0"
    # Beyond the largest float, C reads infinity, whose name differs between compilers.
    text = {"inf": "1.0e39f", "-inf": "-1.0e39f"}.get(repr(expression.value))
    return f"K({text or f'{expression.value!r}f'})"


def _in_order(outputs: Sequence[Expression]) -> list[Expression]:
    """Return all expressions that the outputs depend on, operands before their uses."""
    done: set[int] = set()
    order: list[Expression] = []
    # A stack instead of recursion: chains of thousands of operations exceed Python's limit.
    waiting = list(reversed(outputs))
    while waiting:
        expression = waiting[-1]
        missing = [operand for operand in expression.operands if id(operand) not in done]
        if missing and id(expression) not in done:
            waiting += reversed(missing)
            continue
        waiting.pop()
        if id(expression) not in done:
            done.add(id(expression))
            order.append(expression)
    return order


# Threads per block of a GPU: few, so that a few thousand environments occupy all multiprocessors.
_THREADS = 32
GPU_FLAGS = ["--prec-div=false", "--prec-sqrt=false"]
"""Quotients and roots to two units in the last place, as inductor compiles them, and without calls for them."""
# Without errno and traps the compiler may vectorise roots and comparisons.
_FLAGS = ("-O2", "-march=native", "-fno-math-errno", "-fno-trapping-math", "-shared", "-fPIC", "-w")


Launch = Callable[[Sequence[Tensor], Tensor], None]
"""Called with rows of inputs, and memory for the output rows."""


def launcher(source: str, inputs: int, device: torch.device) -> Launch:
    """Compile a program with this number of inputs, and return its launcher.

    Raises:
        Unfusable: the compiler refuses it, or there is none.
    """
    return _of_library(_compiled(source), inputs) if device.type == "cpu" else _of_gpu(source)


def _compiled(source: str) -> Path:
    """Compile the source to a library, next to the cache of torch's compiler; reuse an earlier one."""
    from torch._inductor.cpp_builder import get_cpp_compiler
    from torch._inductor.runtime.cache_dir_utils import cache_dir

    compiler = get_cpp_compiler()
    # The processor's features are part of the key, for -march=native code runs on no other kind.
    name = hashlib.sha256("\n".join((source, compiler, *_FLAGS, _processor())).encode()).hexdigest()[:32]
    folder = Path(cache_dir()) / "orbit_fusion"
    library = folder / f"{name}.so"
    if library.is_file():
        return library
    folder.mkdir(parents=True, exist_ok=True)
    with ScratchFolder("orbit-kernel-", folder) as work:
        text, made = work / "fused.cpp", work / "fused.so"
        text.write_text(source)
        run = subprocess.run([compiler, *_FLAGS, "-o", str(made), str(text)], capture_output=True, text=True)
        if run.returncode:
            raise Unfusable(f"{compiler} refuses it: {next(iter(run.stderr.splitlines()), '')}")
        os.replace(made, library)  # atomic, for other processes may look for it
    return library


def _processor() -> str:
    try:
        lines = Path("/proc/cpuinfo").read_text().splitlines()
    except OSError:
        return ""
    return next((line for line in lines if line.startswith(("flags", "Features"))), "")


def _of_library(library: Path, inputs: int) -> Launch:
    function: Any = ctypes.CDLL(str(library)).fused
    function.argtypes, function.restype = [*[ctypes.c_void_p] * (inputs + 1), ctypes.c_int], None
    return lambda rows, outputs: function(*(r.data_ptr() for r in rows), outputs.data_ptr(), outputs.shape[0])


def _of_gpu(source: str) -> Launch:
    try:
        # Private in torch, and the only NVRTC binding that is always installed with it.
        compile_kernel = torch.cuda._compile_kernel  # pyright: ignore[reportPrivateUsage]
        kernel: Any = compile_kernel(source, "fused", nvcc_options=GPU_FLAGS)
    except Exception as error:  # torch's release has none, there is no NVRTC, or it refuses the source
        what = " ".join(str(error).splitlines()[:3])
        raise Unfusable(f"no kernel on the GPU, for {type(error).__name__}: {what}") from error

    def launch(rows: Sequence[Tensor], outputs: Tensor) -> None:
        count = outputs.shape[0]
        kernel(grid=(-(-count // _THREADS), 1, 1), block=(_THREADS, 1, 1), args=[*rows, outputs, count])

    return launch


class Fused(Traceable):
    """A function that runs as it is, or, within :func:`orbit_core.capture.replay.fusing`, as one kernel.

    A compiler for whole steps generates loops, and calls libraries for products and factors of matrices;
    what a servo does to the few numbers of each environment is then a hundred launches, most of them for work of a
    microsecond. Here the function is executed symbolically once: terms that constants make zero are removed,
    common terms are computed once, and the rest is straight-line arithmetic.

    Args:
        function: of float or bool tensors (N, ...), by name, that gives float tensors (N, ...). Environments do not
            look at each other; every other tensor that it uses is a constant, and how many environments there are it
            asks of its inputs alone.
        in_parts: True if tensors are (N, S, ...), of S parts of each environment, each of which has a separate row;
            (N, 1, ...) where all parts of an environment have the same, (1, S, ...) where all environments have.
    """

    def __init__(self, function: Callable[..., tuple[Tensor, ...]], in_parts: bool = False) -> None:
        self._function = function
        self._leading = 2 if in_parts else 1
        self._program: Program | None = None
        self._launch: Launch | None = None
        self._rows: dict[str, list[str]] = {}
        self._shapes: list[torch.Size] = []
        self._sizes = torch.Size()
        self.refusal = ""
        """Reason why there is no kernel; empty if there is one, or none was requested."""

    @property
    def operations(self) -> int:
        """Arithmetic operations per row in the kernel; zero without one."""
        return 0 if self._launch is None or self._program is None else self._program.operations()

    def __call__(self, **inputs: Tensor) -> tuple[Tensor, ...]:
        """Return the function's results."""
        if not kernels_wanted() or not self._ready(inputs):
            return self._function(**inputs)
        rows = [
            torch.cat([inputs[name].flatten(self._leading).float() for name in names], -1)
            for names in self._rows.values()
        ]
        assert self._program is not None, "it is ready"
        with _disable_current_modes():  # memory of this call's own, that is there before each replay
            given = self._program.room(self._sizes)
        self._run(rows, given.flatten(0, -2))
        parts = given.split([shape.numel() for shape in self._shapes], -1)
        return tuple(part.reshape(*given.shape[:-1], *shape) for part, shape in zip(parts, self._shapes, strict=True))

    @changes()
    def _run(self, rows: Sequence[Tensor], outputs: Tensor) -> None:
        assert self._launch is not None
        self._launch([row.contiguous() for row in rows], outputs)

    def _ready(self, inputs: Mapping[str, Tensor]) -> bool:
        """Return True if there is a kernel; compile it at the first call."""
        if self._launch is None and not self.refusal:
            try:
                with _disable_current_modes():  # what is followed here is no part of a step that is traced
                    self._make(inputs)
            except Unfusable as reason:
                self.refusal = str(reason)
        return self._launch is not None

    def _make(self, inputs: Mapping[str, Tensor]) -> None:
        names, leading, device = list(inputs), self._leading, next(iter(inputs.values())).device
        sizes = torch.broadcast_shapes(*(tensor.shape[:leading] for tensor in inputs.values()))
        rows = [_row_of(tensor.shape[:leading], sizes) for tensor in inputs.values()]
        made = expressions(
            lambda *tensors: self._function(**dict(zip(names, tensors, strict=True))),
            list(inputs.values()), rows, leading,
        )  # fmt: skip
        self._rows = {row: [name for name, other in zip(names, rows, strict=True) if other == row] for row in rows}
        # Inputs of one kind of row are concatenated, so that a kernel has at most three input pointers.
        widths = {
            row: sum(inputs[name].shape[leading:].numel() for name in members) for row, members in self._rows.items()
        }
        outputs = [number for numbers in made for number in numbers.ravel()]
        self._program = Program(widths, outputs, sizes[1:].numel(), device)
        self._shapes = [torch.Size(numbers.shape[leading:]) for numbers in made]
        self._sizes = torch.Size(sizes)
        self._launch = launcher(self._program.source(), len(widths), device)


def _row_of(shape: torch.Size, sizes: torch.Size) -> str:
    """Return the kind of row (:data:`ROWS`) of an input."""
    if shape == sizes:
        return "own" if len(sizes) > 1 else "env"
    return "env" if shape[0] == sizes[0] else "part"
