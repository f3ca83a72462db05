"""Nodes of general use, and edges between ports: every mistake of wiring is an error before anything runs."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from graphlib import CycleError, TopologicalSorter

import torch
from torch import Tensor

from orbit_core.interfaces import ConfigurationError, Node, Port, ShapeError, UnknownNameError

Endpoint = tuple[str, str]
"""Node and port; the node's name is empty for a port of the graph itself."""


@dataclass(frozen=True)
class Edge:
    """Edge from an output port to an input port, each ``"node.port"``; a port of the graph itself is its bare name."""

    source: str
    target: str


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
        # Flattened, so that pictures and vectors fit into one input.
        parts = [inputs[port.name].flatten(1) for port in self.inputs]
        return {self.outputs[0].name: torch.cat(parts, dim=1)}
