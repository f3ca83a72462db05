"""One node's turns: gathers its inputs, keeps its outputs, and renews them for environments that were reset."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import torch
from torch import Tensor

from orbit_core.agent.wiring import Endpoint
from orbit_core.interfaces import ConfigurationError, Node, Port, ShapeError


@dataclass(frozen=True)
class RunnerState:
    """A snapshot of one node and its place in the schedule."""

    memory: Mapping[str, Tensor]
    last_turn: int
    pending: tuple[Tensor, ...]


class NodeRunner:
    """Runs a node of a graph.

    Args:
        node: to run.
        period: agent steps from one turn to the next.
        sources: what feeds each input.
        slots: where each value stands in ``values``.
        values: the graph's, shared by all its runners.
    """

    def __init__(
        self,
        node: Node,
        period: int,
        sources: Mapping[Endpoint, Endpoint],
        slots: Mapping[Endpoint, int],
        values: list[Tensor | None],
    ) -> None:
        self.node = node
        self.period = period
        self.last_turn = -1
        """Step of the last turn; -1 before the first."""
        self.pending: list[Tensor] = []
        """Environments reset since the last turn."""
        self._sources = [(port.name, slots[sources[node.name, port.name]]) for port in node.inputs]
        self._targets = [(port.name, slots[node.name, port.name]) for port in node.outputs]
        self._ports = list(zip(node.outputs, (slot for _, slot in self._targets), strict=True))
        self._values = values
        self._ports_checked = False

    def turn(self, step: int) -> None:
        """Run the node for all environments."""
        outputs = self._compute()
        values = self._values
        if self.period == 1:
            for name, slot in self._targets:
                values[slot] = outputs[name]
        else:  # what is held must not change with a buffer that the node, or an engine, writes anew
            for name, slot in self._targets:
                values[slot] = outputs[name].clone()
        self.last_turn = step
        self.pending.clear()

    def renew(self) -> None:
        """Run the node, but keep its outputs and memory of all environments other than those reset."""
        env_ids = self.pending[0] if len(self.pending) == 1 else torch.cat(self.pending)
        self.pending.clear()
        held = {slot: value.clone() for _, slot in self._targets if (value := self._values[slot]) is not None}
        remembered = {name: tensor.clone() for name, tensor in self.node.memory().items()}
        outputs = self._compute()
        for name, slot in self._targets:
            self._values[slot] = held[slot].index_copy_(0, env_ids, outputs[name].index_select(0, env_ids))
        for name, tensor in self.node.memory().items():
            tensor.copy_(remembered[name].index_copy_(0, env_ids, tensor.index_select(0, env_ids)))

    def reset(self, env_ids: Tensor | None) -> None:
        """Make the node forget some environments, or all."""
        self.node.reset(env_ids)
        if env_ids is None:
            self.last_turn = -1
            self.pending.clear()
        elif self._targets:
            self.pending.append(env_ids)

    def put(self, values: Mapping[str, Tensor], step: int) -> None:
        """Take outputs from outside in place of a turn, or of a renewal."""
        given = [(slot, checked(values, port, f"output of '{self.node.name}'")) for port, slot in self._ports]
        if self.due(step):
            for slot, value in given:
                self._values[slot] = value if self.period == 1 else value.clone()
            self.last_turn = step
        elif self.pending:
            env_ids = torch.cat(self.pending)
            for slot, value in given:
                held = self._values[slot]
                assert held is not None  # a node that is not due has had a turn
                self._values[slot] = held.index_copy(0, env_ids, value.index_select(0, env_ids))
        self.pending.clear()

    def due(self, step: int) -> bool:
        """Whether it is the node's turn."""
        return step % self.period == 0 and self.last_turn != step

    def save_state(self) -> RunnerState:
        """What the node's next turns depend on."""
        memory = {name: tensor.clone() for name, tensor in self.node.memory().items()}
        return RunnerState(memory, self.last_turn, tuple(ids.clone() for ids in self.pending))

    def load_state(self, state: RunnerState) -> None:
        """Return to a saved state."""
        for name, tensor in self.node.memory().items():
            tensor.copy_(state.memory[name])
        self.last_turn = state.last_turn
        self.pending[:] = state.pending

    def _compute(self) -> Mapping[str, Tensor]:
        values = self._values
        # Every source comes before its targets, so each slot holds a tensor by now.
        inputs: dict[str, Tensor] = {name: values[slot] for name, slot in self._sources}  # pyright: ignore
        outputs = self.node.compute(inputs)
        if not self._ports_checked:
            for port in self.node.outputs:
                checked(outputs, port, f"output of node '{self.node.name}'")
            self._ports_checked = True
        return outputs


def checked(values: Mapping[str, Tensor], port: Port, what: str) -> Tensor:
    """The value of a port.

    Raises:
        ConfigurationError: it is missing.
        ShapeError: its shape is not (num_envs, *port.shape).
    """
    value = values.get(port.name)
    if value is None:
        given = ", ".join(sorted(values)) or "nothing"
        raise ConfigurationError(f"{what} '{port.name}' is missing: given are {given}")
    if value.shape[1:] != port.shape:
        expected = ", ".join(("num_envs", *map(str, port.shape)))
        raise ShapeError(f"{what} '{port.name}' must have shape ({expected}), not {tuple(value.shape)}")
    return value
