"""Small nodes of general use."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence

import torch
from torch import Tensor

from orbit_core.interfaces import Node, Port


class FunctionNode(Node):
    """A function without memory as a node."""

    def __init__(
        self,
        name: str,
        function: Callable[[Mapping[str, Tensor]], Mapping[str, Tensor]],
        inputs: Sequence[Port] = (),
        outputs: Sequence[Port] = (),
        rate: float | None = None,
    ) -> None:
        self.name = name
        self.inputs = tuple(inputs)
        self.outputs = tuple(outputs)
        self.rate = rate
        self._function = function

    def compute(self, inputs: Mapping[str, Tensor]) -> Mapping[str, Tensor]:
        return self._function(inputs)


class Concatenate(Node):
    """Puts its inputs, each flattened to (num_envs, k), side by side in their declared order."""

    def __init__(self, name: str, inputs: Sequence[Port], output: str = "value", rate: float | None = None) -> None:
        self.name = name
        self.inputs = tuple(inputs)
        self.outputs = (Port(output, (sum(math.prod(port.shape) for port in inputs),)),)
        self.rate = rate

    def compute(self, inputs: Mapping[str, Tensor]) -> Mapping[str, Tensor]:
        parts = [inputs[port.name].flatten(1) for port in self.inputs]
        return {self.outputs[0].name: torch.cat(parts, dim=1)}
