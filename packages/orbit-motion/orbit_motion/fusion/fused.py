"""A function of a few numbers for each environment, made one kernel where a step is compiled."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

import torch
from torch import Tensor
from torch.utils._python_dispatch import _disable_current_modes

from orbit_core.capture.kernels import kernels_wanted
from orbit_core.interfaces.capture import Traceable, changes
from orbit_motion.fusion.interpreter import Unfusable, expressions
from orbit_motion.fusion.kernel import Launch, launcher
from orbit_motion.fusion.source import Program


class Fused(Traceable):
    """``function(**inputs)`` as it is, or, within :func:`orbit_core.capture.kernels.fusing`, as one kernel.

    A compiler for whole steps makes loops of what it finds, and calls libraries for products and factors of matrices;
    what a servo does to the few numbers of each environment is then a hundred launches, most of them for work of a
    microsecond. Here the function is followed once, number by number: what constants make zero is left out,
    what occurs twice is computed once, and the rest is a straight line of arithmetic.

    Args:
        function: of float or bool tensors (N, ...), by name, that gives float tensors (N, ...). Environments do not
            look at each other; every other tensor that it uses is a constant, and how many environments there are it
            asks of its inputs alone.
        in_parts: whether tensors are (N, S, ...), of S parts of each environment, each of which is a row of its own;
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
        """Why there is no kernel; empty if there is, or none was asked for."""

    @property
    def operations(self) -> int:
        """Of arithmetic for each row in the kernel; zero without one."""
        return 0 if self._launch is None or self._program is None else self._program.operations()

    def __call__(self, **inputs: Tensor) -> tuple[Tensor, ...]:
        """What the function gives."""
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
        """Whether there is a kernel, made now if there was none."""
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
        widths = {
            row: sum(inputs[name].shape[leading:].numel() for name in members) for row, members in self._rows.items()
        }
        outputs = [number for numbers in made for number in numbers.ravel()]
        self._program = Program(widths, outputs, sizes[1:].numel(), device)
        self._shapes = [torch.Size(numbers.shape[leading:]) for numbers in made]
        self._sizes = torch.Size(sizes)
        self._launch = launcher(self._program.source(), len(widths), device)


def _row_of(shape: torch.Size, sizes: torch.Size) -> str:
    """Which of :data:`~orbit_motion.fusion.source.ROWS` an input lies in."""
    if shape == sizes:
        return "own" if len(sizes) > 1 else "env"
    return "env" if shape[0] == sizes[0] else "part"
