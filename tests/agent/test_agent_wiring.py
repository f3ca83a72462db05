"""Every mistake of wiring an agent is an error that names the culprit."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import pytest
from torch import Tensor

from orbit_core.agent import AgentGraph, Cut, Edge, FunctionNode
from orbit_core.interfaces import ConfigurationError, Node, Port, ShapeError, UnknownNameError


def _node(name: str, inputs: str = "", outputs: str = "", size: int = 2, rate: float | None = None) -> Node:
    def never(values: Mapping[str, Tensor]) -> Mapping[str, Tensor]:
        raise AssertionError("nodes must not run while the graph is built")

    def ports(names: str) -> Sequence[Port]:
        return [Port(port, (size,)) for port in names.split()]

    return FunctionNode(name, never, ports(inputs), ports(outputs), rate)


def test_order_puts_sources_before_targets() -> None:
    nodes = [_node("last", "x"), _node("middle", "x", "y"), _node("first", "", "y")]
    graph = AgentGraph(nodes, [Edge("middle.y", "last.x"), Edge("first.y", "middle.x")], rate=100.0)
    assert [node.name for node in graph.wiring.order] == ["first", "middle", "last"]


def test_unknown_names_come_with_the_nearest() -> None:
    nodes = [_node("camera", "", "image"), _node("encoder", "image", "features")]
    with pytest.raises(UnknownNameError, match=r"unknown node 'camra'.*did you mean 'camera'"):
        AgentGraph(nodes, [Edge("camra.image", "encoder.image")], rate=10.0)
    with pytest.raises(UnknownNameError, match="unknown output port 'imag' in node 'camera': did you mean 'image'"):
        AgentGraph(nodes, [Edge("camera.imag", "encoder.image")], rate=10.0)
    with pytest.raises(UnknownNameError, match="unknown input port 'features' in node 'encoder'"):
        AgentGraph(nodes, [Edge("camera.image", "encoder.features")], rate=10.0)
    with pytest.raises(UnknownNameError, match="unknown input port 'command' in the graph"):
        AgentGraph(nodes, [Edge("command", "encoder.image")], rate=10.0)
    graph = AgentGraph(nodes, [Edge("camera.image", "encoder.image")], rate=10.0)
    with pytest.raises(UnknownNameError, match="did you mean 'encoder'"):
        Cut(graph, "encode")


def test_names_must_be_their_own() -> None:
    with pytest.raises(ConfigurationError, match="two nodes share the name 'a'"):
        AgentGraph([_node("a"), _node("a")], [], rate=10.0)
    with pytest.raises(ConfigurationError, match="two output ports of node 'a' share a name"):
        AgentGraph([_node("a", "", "x x")], [], rate=10.0)
    with pytest.raises(ConfigurationError, match=r"without dots, not 'a.b'"):
        AgentGraph([_node("a.b")], [], rate=10.0)


def test_every_input_has_exactly_one_source() -> None:
    nodes = [_node("one", "", "y"), _node("two", "", "y"), _node("sink", "x")]
    with pytest.raises(ConfigurationError, match=r"input 'sink.x' has no source: .*one.y, two.y"):
        AgentGraph(nodes, [], rate=10.0)
    with pytest.raises(ConfigurationError, match=r"input 'sink.x' has two sources, 'one.y' and 'two.y'"):
        AgentGraph(nodes, [Edge("one.y", "sink.x"), Edge("two.y", "sink.x")], rate=10.0)
    with pytest.raises(ConfigurationError, match="the graph's output 'out' has no source"):
        AgentGraph([_node("one", "", "y")], [], rate=10.0, outputs=[Port("out", (2,))])


def test_shapes_must_be_equal() -> None:
    nodes = [_node("one", "", "y", size=3), _node("sink", "x", size=2)]
    with pytest.raises(ShapeError, match=r"'one.y' \(3,\) cannot feed 'sink.x' \(2,\)"):
        AgentGraph(nodes, [Edge("one.y", "sink.x")], rate=10.0)


def test_a_cycle_is_printed() -> None:
    nodes = [_node("a", "x", "y"), _node("b", "x", "y"), _node("c", "x", "y")]
    edges = [Edge("a.y", "b.x"), Edge("b.y", "c.x"), Edge("c.y", "a.x")]
    with pytest.raises(ConfigurationError, match=r"cycle: (a -> b -> c -> a|b -> c -> a -> b|c -> a -> b -> c);"):
        AgentGraph(nodes, edges, rate=10.0)


@pytest.mark.parametrize(
    ("rate", "message"),
    [
        (30.0, "30 Hz, does not divide the agent's, 100 Hz: use 25 Hz or 33.3333 Hz"),
        (150.0, "150 Hz, does not divide the agent's, 100 Hz: use 100 Hz$"),
        (0.0, "must be above zero"),
        (float("nan"), "must be above zero"),
    ],
)
def test_rates_must_divide_the_agents(rate: float, message: str) -> None:
    with pytest.raises(ConfigurationError, match=message):
        AgentGraph([_node("a", rate=rate)], [], rate=100.0)


def test_a_rate_that_divides_gives_its_period() -> None:
    graph = AgentGraph([_node("a", rate=100.0 / 3.0), _node("b")], [], rate=100.0)
    assert dict(graph.wiring.periods) == {"a": 3, "b": 1}
