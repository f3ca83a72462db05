"""A graph of ONNX as a module of torch, for operators that compute numbers from numbers and do nothing else.

The meaning of the operators is that of ONNX's operator set 13 and later: https://onnx.ai/onnx/operators/.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from orbit_core.interfaces import ConfigurationError, NonFiniteError, UnknownNameError
from orbit_learn.policy_cost import depth_of

_MOST_NODES = 10_000
# Most numbers of one environment between two operators.
_MOST_NUMBERS = 2**24


def _gemm(
    a: Tensor, b: Tensor, c: Tensor | None = None, *, alpha: float = 1.0, beta: float = 1.0, transA: int = 0,
    transB: int = 0,
) -> Tensor:  # fmt: skip
    a, b = a.T if transA else a, b.T if transB else b
    if c is not None and alpha == beta == 1.0:
        return torch.addmm(c, a, b)
    product = alpha * (a @ b)
    return product if c is None else product + beta * c


def _clip(value: Tensor, low: Tensor | None = None, high: Tensor | None = None) -> Tensor:
    return value if low is None and high is None else torch.clamp(value, low, high)


OPERATORS: dict[str, Callable[..., Tensor]] = {
    "Add": torch.add,
    "Clip": _clip,
    "Concat": lambda *values, axis: torch.cat(values, axis),
    "Div": torch.div,
    "Elu": lambda value, *, alpha=1.0: F.elu(value, alpha),
    "Exp": torch.exp,
    "Gemm": _gemm,
    "Identity": lambda value: value,
    "LeakyRelu": lambda value, *, alpha=0.01: F.leaky_relu(value, alpha),
    "MatMul": torch.matmul,
    "Max": torch.maximum,
    "Min": torch.minimum,
    "Mul": torch.mul,
    "Neg": torch.neg,
    "Relu": torch.relu,
    "Sigmoid": torch.sigmoid,
    "Softplus": F.softplus,
    "Sqrt": torch.sqrt,
    "Sub": torch.sub,
    "Tanh": torch.tanh,
}
"""Each takes the node's inputs, None where one is left out, and its attributes by keyword."""


@dataclass(frozen=True)
class _Operation:
    function: Callable[..., Tensor]
    inputs: tuple[str, ...]
    output: str
    attributes: dict[str, Any]


class OnnxGraph(nn.Module):
    """Observation (N, O) -> action (N, A).

    Args:
        graph: an ``onnx.GraphProto`` with one input, one output and float32 weights, all inside it.
        onnx: the package, which its user has imported.

    Raises:
        UnknownNameError: an operator is not among :data:`OPERATORS`.
        NonFiniteError: weights hold NaN or infinity.
        ConfigurationError: anything else of the above does not hold.
    """

    def __init__(self, graph: Any, onnx: Any) -> None:
        super().__init__()
        self.watch: Callable[[Sequence[int], int], None] | None = None
        """Told the shape of each result, and the multiplications that a number of it takes."""
        if len(graph.node) > _MOST_NODES:
            raise ConfigurationError(f"its graph has {len(graph.node):,} nodes, more than {_MOST_NODES:,}")
        weights = {weight.name: _numbers(weight, onnx) for weight in graph.initializer}
        inputs = [entry.name for entry in graph.input if entry.name not in weights]
        if len(inputs) != 1 or len(graph.output) != 1:
            raise ConfigurationError(
                f"its graph has {len(inputs)} inputs and {len(graph.output)} outputs, not one each; a policy that "
                "sees a dictionary of terms is not read from ONNX: play its .safetensors file"
            )
        self._input, self._output = inputs[0], graph.output[0].name
        self._operations: list[_Operation] = []
        for node in graph.node:
            if node.op_type == "Constant":
                weights[node.output[0]] = _constant(node, onnx)
            else:
                self._operations.append(_operation(node, onnx))
        self._buffer_of = {name: f"weight_{i}" for i, name in enumerate(weights)}
        for name, buffer in self._buffer_of.items():
            self.register_buffer(buffer, weights[name])
        self._check_order()

    def forward(self, observation: Tensor) -> Tensor:
        values: dict[str, Tensor | None] = {name: getattr(self, buffer) for name, buffer in self._buffer_of.items()}
        values |= {"": None, self._input: observation}
        most = _MOST_NUMBERS * len(observation)
        for operation in self._operations:
            inputs = [values[name] for name in operation.inputs]
            result = operation.function(*inputs, **operation.attributes)
            if result.numel() > most:
                raise RuntimeError(f"'{operation.output}' has {result.numel():,} numbers, more than {most:,}")
            if self.watch is not None:
                product = operation.function in (torch.matmul, _gemm)
                depth = depth_of(product, inputs[0], bool(operation.attributes.get("transA"))) if inputs else 1
                self.watch((1, result.numel() // len(observation)), depth)
            values[operation.output] = result
        action = values[self._output]
        assert action is not None
        return action

    def _check_order(self) -> None:
        """Refuse a graph that uses what it has not computed yet."""
        known = {"", self._input, *self._buffer_of}
        for operation in self._operations:
            for name in operation.inputs:
                if name not in known:
                    raise ConfigurationError(f"its graph uses '{name[:60]}' before anything computes it")
            known.add(operation.output)
        if self._output not in known - {""}:
            raise ConfigurationError(f"nothing computes its graph's output '{self._output[:60]}'")


def _operation(node: Any, onnx: Any) -> _Operation:
    if node.domain not in ("", "ai.onnx") or node.op_type not in OPERATORS:
        raise UnknownNameError("operator", f"{node.domain}.{node.op_type}".strip(".")[:60], OPERATORS)
    if len(node.output) != 1:
        raise ConfigurationError(f"its operator {node.op_type} has {len(node.output)} outputs, not one")
    numbers = (onnx.AttributeProto.FLOAT, onnx.AttributeProto.INT)
    for attribute in node.attribute:
        if attribute.type not in numbers:
            raise ConfigurationError(f"attribute '{attribute.name[:60]}' of its operator {node.op_type} is no number")
    attributes = {attribute.name: onnx.helper.get_attribute_value(attribute) for attribute in node.attribute}
    return _Operation(OPERATORS[node.op_type], tuple(node.input), node.output[0], attributes)


def _constant(node: Any, onnx: Any) -> Tensor:
    if len(node.attribute) != 1 or node.attribute[0].type != onnx.AttributeProto.TENSOR or len(node.output) != 1:
        raise ConfigurationError("its graph has a constant that is no tensor")
    return _numbers(node.attribute[0].t, onnx, node.output[0])


def _numbers(weight: Any, onnx: Any, name: str = "") -> Tensor:
    name = (weight.name or name)[:60]
    if weight.data_location == onnx.TensorProto.EXTERNAL or weight.external_data:
        raise ConfigurationError(f"weights '{name}' lie in another file, which is not read: save them inside the model")
    if weight.data_type != onnx.TensorProto.FLOAT:
        raise ConfigurationError(f"weights '{name}' are not float32")
    numbers = torch.from_numpy(onnx.numpy_helper.to_array(weight).copy())
    if not bool(torch.isfinite(numbers).all()):
        raise NonFiniteError(f"weights '{name}' hold NaN or infinity")
    return numbers
