"""Agents: directed graphs of timed nodes, run in order, each at its own rate, and cut at a node to be learned."""

from __future__ import annotations

import math
from collections.abc import Callable, Hashable, Mapping, Sequence
from dataclasses import dataclass
from graphlib import CycleError, TopologicalSorter
from typing import Any

import torch
from torch import Tensor

from orbit_core.dynamics.indexing import write_rows
from orbit_core.interfaces import ConfigurationError, Node, Port, ShapeError, UnknownNameError, find_name
from orbit_core.interfaces.capture import Schedule

# Nodes of general use, and edges between ports: every mistake of wiring is an error before anything runs.

Endpoint = tuple[str, str]
"""Node and port; the node's name is empty for a port of the graph itself."""


@dataclass(frozen=True)
class Edge:
    """Edge from an output port to an input port, each ``"node.port"``; a port of the graph itself is its bare name."""

    source: str
    """Output port that values come from."""
    target: str
    """Input port that they go to."""


@dataclass(frozen=True)
class Wiring:
    """A checked graph."""

    order: tuple[Node, ...]
    """Sources before targets; otherwise as given."""
    periods: Mapping[str, int]
    """Agent steps from one turn of a node to the next, by name."""
    sources: Mapping[Endpoint, Endpoint]
    """What feeds each input of a node and each output of the graph."""
    ports: Mapping[Endpoint, Port]
    """What gives a value: the inputs of the graph and the outputs of nodes."""

    def ancestors(self, name: str) -> frozenset[str]:
        """Names of all nodes that the node depends on, near or far."""
        found: set[str] = set()
        left = [name]
        while left:
            direct = _predecessors(left.pop(), self.sources)
            left += [other for other in direct if other not in found]
            found.update(direct)
        return frozenset(found)


def wire(
    nodes: Sequence[Node], edges: Sequence[Edge], rate: float, inputs: Sequence[Port], outputs: Sequence[Port]
) -> Wiring:
    """Check the graph and put its nodes in order.

    Raises:
        UnknownNameError: an edge names a node or port that is not there.
        ConfigurationError: two nodes or ports share a name, an input has no source or two, nodes form a cycle, or a
            node's rate does not divide the agent's.
        ShapeError: an edge joins ports of different shapes.
    """
    by_name = _by_name(nodes)
    givers = _ports("", inputs, "input") | _all_ports(nodes, "outputs")
    takers = _ports("", outputs, "output") | _all_ports(nodes, "inputs")
    sources = _sources(edges, givers, takers, by_name)
    for taker, port in takers.items():
        # Listing the outputs of the right shape finds most mistakes of naming.
        if taker not in sources:
            fitting = [label(giver) for giver, given in givers.items() if given.shape == port.shape]
            hint = f"connect one of the outputs of its shape {port.shape}: {', '.join(fitting) or 'there is none'}"
            raise ConfigurationError(f"{_kind(taker, 'input')} '{label(taker)}' has no source: {hint}")
    # Rates are turned into whole periods here, so that a step compares integers only.
    periods = {node.name: _period(node, rate) for node in nodes}
    return Wiring(_order(by_name, sources), periods, sources, givers)


def label(endpoint: Endpoint) -> str:
    """The endpoint as edges write it."""
    node, port = endpoint
    return f"{node}.{port}" if node else port


def _by_name(nodes: Sequence[Node]) -> dict[str, Node]:
    by_name: dict[str, Node] = {}
    for node in nodes:
        if node.name in by_name:
            raise ConfigurationError(f"two nodes share the name '{node.name}': give each its own")
        if not node.name or "." in node.name:
            raise ConfigurationError(f"a node's name must be non-empty and without dots, not '{node.name}'")
        by_name[node.name] = node
    return by_name


def _all_ports(nodes: Sequence[Node], side: str) -> dict[Endpoint, Port]:
    return {end: port for node in nodes for end, port in _ports(node.name, getattr(node, side), side[:-1]).items()}


def _ports(node: str, ports: Sequence[Port], kind: str) -> dict[Endpoint, Port]:
    named = {(node, port.name): port for port in ports}
    # A dictionary drops repeated names, which its length shows.
    if len(named) < len(ports):
        owner = f"node '{node}'" if node else "the graph"
        raise ConfigurationError(f"two {kind} ports of {owner} share a name: {[port.name for port in ports]}")
    return named


def _sources(
    edges: Sequence[Edge],
    givers: Mapping[Endpoint, Port],
    takers: Mapping[Endpoint, Port],
    nodes: Mapping[str, Node],
) -> dict[Endpoint, Endpoint]:
    sources: dict[Endpoint, Endpoint] = {}
    for edge in edges:
        source = _find(edge.source, givers, nodes, ("output", "input"))
        target = _find(edge.target, takers, nodes, ("input", "output"))
        if target in sources:
            raise ConfigurationError(
                f"{_kind(target, 'input')} '{edge.target}' has two sources, '{label(sources[target])}' and "
                f"'{edge.source}': remove one edge"
            )
        given, taken = givers[source].shape, takers[target].shape
        if given != taken:
            raise ShapeError(f"'{edge.source}' {given} cannot feed '{edge.target}' {taken}: their shapes must be equal")
        sources[target] = source
    return sources


def _find(text: str, ports: Mapping[Endpoint, Port], nodes: Mapping[str, Node], kinds: tuple[str, str]) -> Endpoint:
    name, dot, port = text.rpartition(".")
    endpoint = (name, port)
    if endpoint in ports:
        return endpoint
    if dot and name not in nodes:
        raise UnknownNameError("node", name, nodes, f"edge endpoint '{text}'")
    where = f"node '{name}'" if dot else "the graph"
    known = [known for owner, known in ports if owner == name]
    raise UnknownNameError(f"{kinds[0] if dot else kinds[1]} port", port, known, where)


def _kind(taker: Endpoint, kind: str) -> str:
    return kind if taker[0] else "the graph's output"


def _predecessors(name: str, sources: Mapping[Endpoint, Endpoint]) -> list[str]:
    return list(dict.fromkeys(source for (owner, _), (source, _) in sources.items() if owner == name and source))


def _order(nodes: Mapping[str, Node], sources: Mapping[Endpoint, Endpoint]) -> tuple[Node, ...]:
    # The sorter keeps the order of insertion among independent nodes, so runs are repeatable.
    sorter = TopologicalSorter({name: _predecessors(name, sources) for name in nodes})
    try:
        return tuple(nodes[name] for name in sorter.static_order())
    except CycleError as error:
        cycle = " -> ".join(error.args[1])
        raise ConfigurationError(f"nodes form a cycle: {cycle}; remove one of its edges") from None


def _period(node: Node, rate: float) -> int:
    if node.rate is None:
        return 1
    if not node.rate > 0.0:
        raise ConfigurationError(f"the rate of node '{node.name}' must be above zero, not {node.rate:g} Hz")
    ratio = rate / node.rate
    period = max(1, round(ratio))
    # Rates such as 100/3 Hz are not exact in floating point.
    if abs(period - ratio) > 1e-6 * ratio:
        nearest = dict.fromkeys(f"{rate / max(1, whole):g} Hz" for whole in (int(ratio) + 1, int(ratio)))
        raise ConfigurationError(
            f"the rate of node '{node.name}', {node.rate:g} Hz, does not divide the agent's, {rate:g} Hz: "
            f"use {' or '.join(nearest)}"
        )
    return period


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
        """Name in the graph."""
        self.inputs = tuple(inputs)
        """Ports whose values the function takes, by name."""
        self.outputs = tuple(outputs)
        """Ports whose values it returns, by name."""
        self.rate = rate
        self._function = function

    def compute(self, inputs: Mapping[str, Tensor]) -> Mapping[str, Tensor]:
        return self._function(inputs)


class Concatenate(Node):
    """Puts its inputs, each flattened to (num_envs, k), side by side in their declared order."""

    def __init__(self, name: str, inputs: Sequence[Port], output: str = "value", rate: float | None = None) -> None:
        self.name = name
        """Name in the graph."""
        self.inputs = tuple(inputs)
        """Ports that are put side by side, in order."""
        self.outputs = (Port(output, (sum(math.prod(port.shape) for port in inputs),)),)
        """Port of the concatenated values, as wide as all inputs together."""
        self.rate = rate

    def compute(self, inputs: Mapping[str, Tensor]) -> Mapping[str, Tensor]:
        # Flattened, so that pictures and vectors fit into one input.
        parts = [inputs[port.name].flatten(1) for port in self.inputs]
        return {self.outputs[0].name: torch.cat(parts, dim=1)}


@dataclass(frozen=True)
class RunnerState:
    """A snapshot of one node and its place in the schedule."""

    memory: Mapping[str, Tensor]
    """Tensors that the node carries from turn to turn, by name."""
    last_turn: int
    """Step of its last turn; -1 before the first."""
    pending: bool
    """True if environments that were reset wait for outputs."""
    waiting: Tensor | None
    """(N,) bool: those environments; None before the first turn."""


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
        # (N,) which were reset; None before the first turn, after which none differ
        self._waiting: Tensor | None = None
        self._sources = [(port.name, slots[sources[node.name, port.name]]) for port in node.inputs]
        self._targets = [(port.name, slots[node.name, port.name]) for port in node.outputs]
        self._ports = list(zip(node.outputs, (slot for _, slot in self._targets), strict=True))
        self._values = values
        self._ports_checked = False

    # The common case has no branch for resets: all environments take the new outputs.
    def turn(self, step: int) -> None:
        """Run the node for all environments."""
        outputs = self._compute()
        for name, slot in self._targets:
            self._keep(slot, outputs[name])
            self._make_room(outputs[name])
        self._took_turn(step)

    def renew(self) -> None:
        """Run the node, but keep its outputs and memory of all environments other than those reset."""
        # Copied before the node runs, since it may write its outputs and memory in place.
        held = {slot: value.clone() for _, slot in self._targets if (value := self._values[slot]) is not None}
        remembered = {name: tensor.clone() for name, tensor in self.node.memory().items()}
        outputs = self._compute()
        for name, slot in self._targets:
            self._keep(slot, self._where_reset(outputs[name], held[slot]))
        for name, tensor in self.node.memory().items():
            tensor.copy_(self._where_reset(tensor, remembered[name]))
        self._none_waits()

    def _make_room(self, value: Tensor) -> None:
        # Made at the first turn, which shows the number of environments and the device.
        if self._waiting is None:
            self._waiting = torch.zeros(len(value), dtype=torch.bool, device=value.device)

    def _keep(self, slot: int, value: Tensor) -> None:
        own = self._values[slot]
        if not self.carries:
            self._values[slot] = value
        elif own is None:  # what is held must not change with a buffer that the node, or an engine, writes again
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
        """Return True if it is the node's turn."""
        return step % self.period == 0 and self.last_turn != step

    def save_state(self) -> RunnerState:
        """Return the state that the node's next turns depend on."""
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
        # Shapes do not change, so only the first outputs are checked.
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


@dataclass(frozen=True)
class GraphState:
    """A snapshot of an agent between two steps."""

    step_count: int
    """Steps of the agent so far."""
    values: tuple[Tensor | None, ...]
    """Last value of each port; None before the first."""
    runners: tuple[RunnerState, ...]
    """Snapshots of the nodes, in the order of their execution."""


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
        UnknownNameError, ConfigurationError, ShapeError: the graph is miswired, :func:`orbit_core.agent.graph.wire`.
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
        """Order of the nodes, their periods, and the sources of their inputs."""
        self.nodes: Mapping[str, Node] = {node.name: node for node in self.wiring.order}
        self.step_count = 0
        """Steps done since the last reset of all environments."""
        # Values are kept in a list by number: a lookup by names would cost a tuple and a hash per port and step.
        slots = {endpoint: slot for slot, endpoint in enumerate(self.wiring.ports)}
        self.values: list[Tensor | None] = [None] * len(slots)
        """The last value of each port of ``wiring.ports``, in its order."""
        self.runners = tuple(
            NodeRunner(node, self.wiring.periods[node.name], self.wiring.sources, slots, self.values)
            for node in self.wiring.order
        )
        """Nodes with their memory and schedule, in the order of execution."""
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
        """Make nodes forget some environments; with all of them (None) the schedule starts again."""
        if env_ids is None:
            self.step_count = 0
        for runner in self.runners:
            runner.reset(env_ids)

    def save_state(self) -> GraphState:
        """Return the state that the continuation depends on: step count, held values and the nodes' memory."""
        values = tuple(None if value is None else value.clone() for value in self.values)
        return GraphState(self.step_count, values, tuple(runner.save_state() for runner in self.runners))

    def load_state(self, state: GraphState) -> None:
        """Return to a saved state."""
        self.step_count = state.step_count
        # Written in place where possible, for a captured step reads the same memory.
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
        """Return the value of a slot of :attr:`values`; a copy if a later step writes it in place."""
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
            # The last multiple of the period before the next step.
            runner.last_turn = (self._graph.step_count - 1) // runner.period * runner.period
            runner.pending = pending


class Cut:
    """An agent without one of its nodes.

    One step of the agent is :meth:`observe`, then :meth:`act`. Nodes that the cut node depends on run with the first,
    all others with the second. To observe again within one step runs nothing twice; it renews what environments that
    were reset meanwhile see.

    Args:
        graph: of the whole agent; the cut steps it.
        name: of the node that is taken out, in whose place stands what :meth:`act` is given.

    Raises:
        UnknownNameError: no node has that name.
    """

    def __init__(self, graph: AgentGraph, name: str) -> None:
        find_name(name, list(graph.nodes), "node", "the agent")
        self.graph = graph
        self.node = graph.nodes[name]
        """Node that is taken out."""
        before = graph.wiring.ancestors(name)
        self._upstream = [runner for runner in graph.runners if runner.node.name in before]
        self._downstream = [runner for runner in graph.runners if runner.node.name not in (*before, name)]
        (self._replaced,) = (runner for runner in graph.runners if runner.node is self.node)
        # Nodes before the cut run in another call than those after it, so their outputs are held like those of slow
        # nodes.
        for runner in self._upstream:  # what was observed in one step is acted on in the next
            runner.carries |= any(
                source[0] == runner.node.name and target[0] not in before
                for target, source in graph.wiring.sources.items()
                if target[0] not in ("", name)
            )
        slots = {endpoint: slot for slot, endpoint in enumerate(graph.wiring.ports)}
        self._observed_step = -1
        self._inputs = [(port.name, slots[graph.wiring.sources[name, port.name]]) for port in self.node.inputs]

    @property
    def due(self) -> bool:
        """True if new outputs count for all environments at this step; a node slower than the agent holds them."""
        return self._replaced.due(self.graph.step_count)

    def observe(self, external: Mapping[str, Tensor] | None = None) -> dict[str, Tensor]:
        """Run everything before the cut.

        Args:
            external: a tensor (num_envs, ...) for each input of the graph.

        Returns:
            each input of the node taken out; the tensors may be nodes' own, so clone what you keep.
        """
        self.graph.take_inputs(external or {})
        self.graph.run(self._upstream)
        self._observed_step = self.graph.step_count
        return {name: self.graph.value(slot) for name, slot in self._inputs}

    def act(self, outputs: Mapping[str, Tensor] | None = None) -> dict[str, Tensor]:
        """Run everything after the cut, and all else that is left; end the step.

        Args:
            outputs: in place of the node's. Where the node is not :attr:`due` they count only for environments reset
                since its turn, and None holds those of before.

        Returns:
            each output of the graph.

        Raises:
            ConfigurationError: an output is missing, or the step has not been observed.
            ShapeError: an output has another shape than its port.
        """
        step = self.graph.step_count
        stale = any(runner.pending or runner.due(step) for runner in self._upstream)
        if stale or (self.graph.inputs and self._observed_step != step):
            raise ConfigurationError(f"nothing has been observed at step {step}, or since a reset: observe, then act")
        if outputs is not None:
            self._replaced.put(outputs, step)
        elif self._replaced.due(step) or self._replaced.pending:
            raise ConfigurationError(f"node '{self.node.name}' is due: act needs its outputs")
        self.graph.run(self._downstream)
        self.graph.step_count += 1
        return self.graph.read_outputs()
