"""Compiling a traced step with torch's inductor: many small operations become a few loops."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Any

import torch
from torch import Tensor, fx

from orbit_core.interfaces import ConfigurationError

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


def compiled(graph: fx.GraphModule, inputs: list[Tensor]) -> Callable[..., Sequence[Tensor]]:
    """The graph, for inputs of the same shapes, as compiled code; what inductor cached on disk is taken from there.

    Raises:
        ConfigurationError: inductor fails.
    """
    import torch._inductor as inductor

    _spell_out_products(graph)
    # Threads cost more than they save on a step's small tensors, and the engine needs the cores. Sizes never change.
    options = {"cpp.threads": 1, "size_asserts": False}
    try:
        with torch.no_grad():
            return inductor.compile(graph, list(inputs), options=options)  # pyright: ignore[reportReturnType]
    except Exception as error:  # of many kinds: inductor's own, the compiler's, the operating system's
        first = next(iter(str(error).splitlines()), "")
        raise ConfigurationError(
            f"the step could not be compiled, for {type(error).__name__}: {first}; check the compiler, {_REMEDY}"
        ) from error


_FEW_NUMBERS = 1024


def _spell_out_products(graph: fx.GraphModule) -> None:
    """Products of small matrices become multiplications and sums, which melt into the loops around them."""
    aten = torch.ops.aten
    for node in list(graph.graph.nodes):
        if node.target not in (aten.mm.default, aten.addmm.default) or node.kwargs:
            continue
        left, right = node.args[-2:]
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
