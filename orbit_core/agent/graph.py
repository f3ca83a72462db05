"""The agent: a directed graph of timed nodes, run in order, each at its own rate."""

from __future__ import annotations

import math
from collections.abc import Hashable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from torch import Tensor

from orbit_core.agent.runner import NodeRunner, RunnerState, checked
from orbit_core.agent.wiring import Edge, Endpoint, Wiring, label, wire
from orbit_core.interfaces import ConfigurationError, Node, Port, find_name
from orbit_core.interfaces.capture import Schedule


@dataclass(frozen=True)
class GraphState:
    """A snapshot of an agent between two steps."""

    step_count: int
    values: tuple[Tensor | None, ...]
    runners: tuple[RunnerState, ...]


class AgentGraph:
    """Nodes and the edges between their ports.

    A node runs at the steps that its period divides, and its outputs hold in between. All environments share one
    schedule. :meth:`reset` does not wait for it: at the next step every node is run, but where it is not a node's turn
    only the reset environments take the new outputs and memory; all others keep theirs. (A node without outputs has
    nothing to renew, and waits for its turn.)

    Args:
        nodes: each with its own name.
        edges: one to each input of every node and to each output of the graph.
        rate: of the agent, in Hz; each node's must divide it.
        inputs: ports through which values come from outside.
        outputs: ports through which values go outside.

    Raises:
        UnknownNameError, ConfigurationError, ShapeError: the graph is miswired, :func:`orbit_core.agent.wiring.wire`.
    """

    def __init__(
        self,
        nodes: Sequence[Node],
        edges: Sequence[Edge],
        rate: float,
        inputs: Sequence[Port] = (),
        outputs: Sequence[Port] = (),
    ) -> None:
        if not rate > 0.0:
            raise ConfigurationError(f"the agent's rate must be above zero, not {rate:g} Hz")
        self.rate = rate
        self.inputs = tuple(inputs)
        self.outputs = tuple(outputs)
        self.wiring: Wiring = wire(nodes, edges, rate, inputs, outputs)
        self.nodes: Mapping[str, Node] = {node.name: node for node in self.wiring.order}
        self.step_count = 0
        """Steps done since the last reset of all environments."""
        slots = {endpoint: slot for slot, endpoint in enumerate(self.wiring.ports)}
        self.values: list[Tensor | None] = [None] * len(slots)
        """The last value of each port of ``wiring.ports``, in its order."""
        self.runners = tuple(
            NodeRunner(node, self.wiring.periods[node.name], self.wiring.sources, slots, self.values)
            for node in self.wiring.order
        )
        self._runner_of = {
            slot: runner for (node, _), slot in slots.items() for runner in self.runners if runner.node.name == node
        }
        self._inputs = [(port, slots["", port.name]) for port in self.inputs]
        self._outputs = [(port.name, slots[self.wiring.sources["", port.name]]) for port in self.outputs]

    def step(self, external: Mapping[str, Tensor] | None = None) -> dict[str, Tensor]:
        """One step of the agent: each node that is due, sources first.

        Args:
            external: a tensor (num_envs, ...) for each input of the graph.

        Returns:
            each output of the graph; the tensors may be nodes' own, so clone what you keep.

        Raises:
            ConfigurationError, ShapeError: an input is missing or of another shape than declared.
        """
        self.take_inputs(external or {})
        self.run(self.runners)
        self.step_count += 1
        return self.read_outputs()

    def replace(self, name: str, node: Node) -> AgentGraph:
        """A graph with another node in that one's place. All others are shared: of the two graphs, step one.

        Raises:
            UnknownNameError, ShapeError: no node has that name, or the other's ports are not the same.
        """
        find_name(name, list(self.nodes), "node", "the agent")

        def renamed(endpoint: Endpoint) -> str:
            owner, port = endpoint
            return label((node.name if owner == name else owner, port))

        nodes = [node if other.name == name else other for other in self.nodes.values()]
        edges = [Edge(renamed(source), renamed(target)) for target, source in self.wiring.sources.items()]
        return AgentGraph(nodes, edges, self.rate, self.inputs, self.outputs)

    def reset(self, env_ids: Tensor | None = None) -> None:
        """Make nodes forget some environments; with all of them (None) the schedule starts anew."""
        if env_ids is None:
            self.step_count = 0
        for runner in self.runners:
            runner.reset(env_ids)

    def save_state(self) -> GraphState:
        """What the continuation depends on: the step count, held values, and the nodes' memory."""
        values = tuple(None if value is None else value.clone() for value in self.values)
        return GraphState(self.step_count, values, tuple(runner.save_state() for runner in self.runners))

    def load_state(self, state: GraphState) -> None:
        """Return to a saved state."""
        self.step_count = state.step_count
        for slot, saved in enumerate(state.values):
            own = self.values[slot]
            if own is None or saved is None:
                self.values[slot] = None if saved is None else saved.clone()
            else:
                own.copy_(saved)
        for runner, saved in zip(self.runners, state.runners, strict=True):
            runner.load_state(saved)

    @property
    def schedule(self) -> Schedule:
        """Counters of the graph's steps, which a captured step moves on."""
        return _GraphSchedule(self)

    # What a step consists of; a cut puts it together otherwise

    def take_inputs(self, external: Mapping[str, Tensor]) -> None:
        """Store the values of the graph's inputs."""
        for port, slot in self._inputs:
            self.values[slot] = checked(external, port, "the graph's input")

    def run(self, runners: Sequence[NodeRunner]) -> None:
        """Run those of the nodes that are due at this step, or have been reset."""
        step = self.step_count
        for runner in runners:
            if step % runner.period == 0 and runner.last_turn != step:
                runner.turn(step)
            elif runner.pending:
                runner.renew()

    def read_outputs(self) -> dict[str, Tensor]:
        """The last values of the graph's outputs."""
        return {name: self.value(slot) for name, slot in self._outputs}

    def value(self, slot: int) -> Tensor:
        """What stands in a slot of :attr:`values`, a copy where a later step writes it in place."""
        value = self.values[slot]
        assert value is not None  # every slot that anything reads has been written by a source before it
        return value.clone() if slot in self._runner_of and self._runner_of[slot].carries else value


class _GraphSchedule(Schedule):
    """Step count of a graph, and which nodes must renew their outputs."""

    def __init__(self, graph: AgentGraph) -> None:
        self._graph = graph

    @property
    def period(self) -> int:
        return math.lcm(*(runner.period for runner in self._graph.runners))

    @property
    def key(self) -> Hashable:
        step = self._graph.step_count
        return tuple([(step % r.period, r.pending and r.period > 1) for r in self._graph.runners])

    @property
    def count(self) -> int:
        return self._graph.step_count

    def move(self, key: Any, steps: int) -> None:
        self._graph.step_count += steps
        for runner, (_, pending) in zip(self._graph.runners, key, strict=True):
            runner.last_turn = (self._graph.step_count - 1) // runner.period * runner.period
            runner.pending = pending
