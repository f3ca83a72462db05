"""A function of a few numbers for each environment, made one kernel where a step is compiled."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from contextvars import ContextVar

import torch
from torch import Tensor
from torch.utils._python_dispatch import _disable_current_modes

from orbit_core.capture.fusion.interpreter import Unfusable, expressions
from orbit_core.capture.fusion.kernel import Launch, launcher
from orbit_core.capture.fusion.source import Program
from orbit_core.interfaces.capture import Watched, measures

_fusing: ContextVar[bool] = ContextVar("fusing", default=False)


@contextmanager
def fusing(wanted: bool) -> Iterator[None]:
    """Whether :class:`Fused` functions are to be kernels within."""
    token = _fusing.set(wanted)
    try:
        yield
    finally:
        _fusing.reset(token)


class Fused(Watched):
    """``function(**inputs)`` as it is, or, within :func:`fusing`, as one kernel.

    A compiler for whole steps makes loops of what it finds, and calls libraries for products and factors of matrices;
    what a servo does to the few numbers of each environment is then a hundred launches, most of them for work of a
    microsecond. Here the function is followed once, number by number: what constants make zero is left out,
    what occurs twice is computed once, and the rest is a straight line of arithmetic.

    Args:
        function: of float or bool tensors (N, ...), by name, that gives float tensors (N, ...). Environments do not
            look at each other; every other tensor that it uses is a constant, and how many environments there are it
            asks of its inputs alone.
    """

    def __init__(self, function: Callable[..., tuple[Tensor, ...]]) -> None:
        self._function = function
        self._launch: Launch | None = None
        self._shapes: list[torch.Size] = []
        self._outputs = torch.empty(0)
        self.operations = 0
        """Of arithmetic for each environment in the kernel; zero without one."""
        self.refusal = ""
        """Why there is no kernel; empty if there is, or none was asked for."""

    def __call__(self, **inputs: Tensor) -> tuple[Tensor, ...]:
        """What the function gives."""
        if not _fusing.get() or not self._ready(inputs):
            return self._function(**inputs)
        given = self._run(torch.cat([tensor.flatten(1).float() for tensor in inputs.values()], 1))
        parts = given.split([shape.numel() for shape in self._shapes], 1)
        return tuple(part.reshape(-1, *shape) for part, shape in zip(parts, self._shapes, strict=True))

    @measures()
    def _run(self, rows: Tensor) -> Tensor:
        assert self._launch is not None
        self._launch(rows.contiguous(), self._outputs)
        return self._outputs

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
        names, tensors = list(inputs), list(inputs.values())
        made = expressions(lambda *rows: self._function(**dict(zip(names, rows, strict=True))), tensors)
        width = sum(tensor[0].numel() for tensor in tensors)
        program = Program(width, [number for numbers in made for number in numbers.ravel()])
        device = tensors[0].device
        self._shapes = [torch.Size(numbers.shape[1:]) for numbers in made]
        self._outputs = torch.empty(tensors[0].shape[0], len(program.outputs), device=device)
        self.operations = program.operations()
        self._launch = launcher(program.source(device), device)
