"""Expressions as source text, for a C++ compiler and for a GPU's.

Both share the arithmetic. On a CPU each variable holds the numbers of several environments, side by side in one
register (GCC's and Clang's vector extensions); on a GPU, where each thread has its environment, of one. What comes of
it lies row by row on a CPU, and column by column on a GPU, where threads that are neighbours write at once.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import torch

from orbit_motion.fusion.expression import Expression

LANES = 8
"""Environments in one register of a CPU."""
ROWS = {"own": "({0})", "env": "({0}) / {1}", "part": "({0}) % {1}"}
"""Rows of inputs: of each environment's each part, of each environment, and of each part in all environments."""
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
    """What the numbers of one environment, or of one part of it, become.

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
        """Whether it is for a CPU."""
        return self.device.type == "cpu"

    def room(self, sizes: torch.Size) -> torch.Tensor:
        """Memory (*sizes, W) for the rows of W numbers that come of so many environments and parts."""
        if self.on_cpu:
            return torch.empty(*sizes, len(self.outputs))
        return torch.empty(len(self.outputs), *sizes, device=self.device).movedim(0, -1)

    def source(self) -> str:
        """Return text with a function ``fused`` of pointers to rows, to what becomes of them, and how many come of
        them.
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
        """How many there are for one environment."""
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
    text = {"inf": "1.0e39f", "-inf": "-1.0e39f"}.get(repr(expression.value))
    return f"K({text or f'{expression.value!r}f'})"


def _in_order(outputs: Sequence[Expression]) -> list[Expression]:
    """Return all that outputs are made of, each after what it is made of itself."""
    done: set[int] = set()
    order: list[Expression] = []
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
