"""One node's turns: gathers its inputs, keeps its outputs, and renews them for environments that were reset."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import torch
from torch import Tensor

from orbit_core.agent.wiring import Endpoint
from orbit_core.dynamics.indexing import write_rows
from orbit_core.interfaces import ConfigurationError, Node, Port, ShapeError


@dataclass(frozen=True)
class RunnerState:
    """A snapshot of one node and its place in the schedule."""

    memory: Mapping[str, Tensor]
    last_turn: int
    pending: bool
    waiting: Tensor | None


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
        self.pending = False
        """Whether some environments were reset since the last turn."""
        self.carries = period > 1
        """Whether its outputs are read in a later step than the one that computes them; they then stay in one place."""
        self._waiting: Tensor | None = None
        """(N,) which were reset; None before the first turn, after which there are none to tell apart."""
        self._sources = [(port.name, slots[sources[node.name, port.name]]) for port in node.inputs]
        self._targets = [(port.name, slots[node.name, port.name]) for port in node.outputs]
        self._ports = list(zip(node.outputs, (slot for _, slot in self._targets), strict=True))
        self._values = values
        self._ports_checked = False

    def turn(self, step: int) -> None:
        """Run the node for all environments."""
        outputs = self._compute()
        for name, slot in self._targets:
            self._keep(slot, outputs[name])
            self._make_room(outputs[name])
        self._took_turn(step)

    def renew(self) -> None:
        """Run the node, but keep its outputs and memory of all environments other than those reset."""
        held = {slot: value.clone() for _, slot in self._targets if (value := self._values[slot]) is not None}
        remembered = {name: tensor.clone() for name, tensor in self.node.memory().items()}
        outputs = self._compute()
        for name, slot in self._targets:
            self._keep(slot, self._where_reset(outputs[name], held[slot]))
        for name, tensor in self.node.memory().items():
            tensor.copy_(self._where_reset(tensor, remembered[name]))
        self._none_waits()

    def _make_room(self, value: Tensor) -> None:
        if self._waiting is None:
            self._waiting = torch.zeros(len(value), dtype=torch.bool, device=value.device)

    def _keep(self, slot: int, value: Tensor) -> None:
        own = self._values[slot]
        if not self.carries:
            self._values[slot] = value
        elif own is None:  # what is held must not change with a buffer that the node, or an engine, writes anew
            self._values[slot] = value.clone()
        else:
            own.copy_(value)

    def _where_reset(self, fresh: Tensor, held: Tensor) -> Tensor:
        assert self._waiting is not None  # an environment waits only after the first turn
        return torch.where(self._waiting.view(-1, *(1 for _ in held.shape[1:])), fresh, held)

    def _took_turn(self, step: int) -> None:
        self.last_turn = step
        self._none_waits()

    def _none_waits(self) -> None:
        if self.pending and self._waiting is not None:
            self._waiting.zero_()
        self.pending = False

    def reset(self, env_ids: Tensor | None) -> None:
        """Make the node forget some environments, or all."""
        self.node.reset(env_ids)
        if env_ids is None:
            self.last_turn = -1
            self._none_waits()
        elif self._waiting is not None:
            write_rows(self._waiting, True, env_ids)
            self.pending = True

    def put(self, values: Mapping[str, Tensor], step: int) -> None:
        """Take outputs from outside in place of a turn, or of a renewal."""
        given = [(slot, checked(values, port, f"output of '{self.node.name}'")) for port, slot in self._ports]
        if self.due(step):
            for slot, value in given:
                self._keep(slot, value)
                self._make_room(value)
            self._took_turn(step)
        elif self.pending:
            for slot, value in given:
                held = self._values[slot]
                assert held is not None  # a node that is not due has had a turn
                self._keep(slot, self._where_reset(value, held))
            self._none_waits()

    def due(self, step: int) -> bool:
        """Whether it is the node's turn."""
        return step % self.period == 0 and self.last_turn != step

    def save_state(self) -> RunnerState:
        """What the node's next turns depend on."""
        memory = {name: tensor.clone() for name, tensor in self.node.memory().items()}
        return RunnerState(
            memory, self.last_turn, self.pending, None if self._waiting is None else self._waiting.clone()
        )

    def load_state(self, state: RunnerState) -> None:
        """Return to a saved state."""
        for name, tensor in self.node.memory().items():
            tensor.copy_(state.memory[name])
        self.last_turn, self.pending = state.last_turn, state.pending
        if state.waiting is not None:
            self._waiting = state.waiting.clone() if self._waiting is None else self._waiting.copy_(state.waiting)
        elif self._waiting is not None:
            self._waiting.zero_()

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
