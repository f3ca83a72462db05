"""Torch's operations on rows of environments, followed number by number."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor, fx
from torch.fx.experimental.proxy_tensor import make_fx
from torch.fx.node import map_arg

from orbit_motion.fusion.expression import Builder
from orbit_motion.fusion.operations import OPERATIONS

Numbers = npt.NDArray[np.object_]
"""Of expressions, in a tensor's shape."""


class Unfusable(Exception):
    """A function does what is not followed number by number; says what."""


def expressions(
    function: Callable[..., Sequence[Tensor]], inputs: Sequence[Tensor], rows: Sequence[str], leading: int
) -> list[Numbers]:
    """What a function makes of one environment's numbers, or of one of several parts of an environment.

    Args:
        function: of tensors (N, ...), or (N, S, ...), whose rows do not look at each other. All other tensors that it
            uses are constants.
        inputs: examples, float or bool; of bools rows hold zeros and ones.
        rows: name of the row that each input lies in, after those before it in the same row.
        leading: how many axes are of rows, 1 or 2.

    Raises:
        Unfusable: an operation is not known here, or the rows depend on each other.
    """
    examples = [tensor[(slice(1),) * leading].detach().clone() for tensor in inputs]
    builder = Builder()
    try:
        graph = make_fx(function, tracing_mode="real")(*examples)
        made = _followed(builder, graph, _elements(builder, examples, rows))
    except Unfusable:
        raise
    except Exception as error:  # of many kinds, for it is anybody's function
        what = next(iter(str(error).splitlines()), "")
        raise Unfusable(f"it cannot be followed, for {type(error).__name__}: {what}") from error
    for numbers in made:
        if numbers.shape[:leading] != (1,) * leading:
            raise Unfusable(f"it gives an array {numbers.shape} for one environment")
    return made


def _followed(builder: Builder, graph: fx.GraphModule, given: Sequence[Numbers]) -> list[Numbers]:
    values: dict[fx.Node, Any] = {}
    remaining = iter(given)

    def value_of(argument: Any) -> Any:
        return values[argument] if isinstance(argument, fx.Node) else argument

    for node in graph.graph.nodes:
        if node.op == "placeholder":
            values[node] = next(remaining)
        elif node.op == "get_attr":
            values[node] = constants(builder, getattr(graph, node.target))
        elif node.op == "output":
            return [value_of(argument) for argument in node.args[0]]
        else:
            name = getattr(node.target, "overloadpacket", node.target).__name__
            operation = OPERATIONS.get(name)
            if operation is None:
                raise Unfusable(f"operation '{name}' is not known")
            arguments = map_arg(node.args, lambda argument: values[argument])
            keywords = map_arg(node.kwargs, lambda argument: values[argument])
            values[node] = operation(builder, *arguments, **keywords)
    raise AssertionError("a graph without an output")


def constants(builder: Builder, tensor: Tensor) -> Numbers:
    """Return a known tensor's numbers."""
    if tensor.dtype in (torch.int64, torch.int32):
        return tensor.detach().cpu().numpy()  # an index
    result = np.empty(tuple(tensor.shape), dtype=object)
    result.ravel()[:] = [builder.constant(value) for value in tensor.detach().cpu().reshape(-1).tolist()]
    return result


def _elements(builder: Builder, examples: Sequence[Tensor], rows: Sequence[str]) -> list[Numbers]:
    given: list[Numbers] = []
    lengths = dict.fromkeys(rows, 0)
    zero = builder.constant(0.0)
    for example, row in zip(examples, rows, strict=True):
        numbers = np.empty(tuple(example.shape), dtype=object)
        elements = [builder.element(row, lengths[row] + place) for place in range(example.numel())]
        is_bool = example.dtype is torch.bool
        numbers.ravel()[:] = [builder.apply("lt", zero, x) for x in elements] if is_bool else elements
        lengths[row] += len(elements)
        given.append(numbers)
    return given
