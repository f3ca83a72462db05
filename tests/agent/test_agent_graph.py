"""An agent runs its nodes in time: schedules, holds, resets, snapshots and cuts."""

from __future__ import annotations

from collections.abc import Mapping

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from torch import Tensor

from orbit_core.agent import AgentGraph, Concatenate, Cut, Edge, FunctionNode
from orbit_core.interfaces import ConfigurationError, Node, Port, ShapeError

ENVIRONMENTS = 3
SCALAR = Port("x", (1,))


class Integrator(Node):
    """Adds its input to a sum of its own, and counts its turns."""

    inputs = (SCALAR,)
    outputs = (Port("sum", (1,)),)

    def __init__(self, name: str, rate: float | None = None) -> None:
        self.name = name
        self.rate = rate
        self.total = torch.zeros(ENVIRONMENTS, 1)
        self.turns = 0

    def compute(self, inputs: Mapping[str, Tensor]) -> Mapping[str, Tensor]:
        self.turns += 1
        self.total += inputs["x"]  # in place, so that a graph which holds must keep a copy of its own
        return {"sum": self.total}

    def reset(self, env_ids: Tensor | None = None) -> None:
        self.total[slice(None) if env_ids is None else env_ids] = 0.0

    def memory(self) -> Mapping[str, Tensor]:
        return {"total": self.total}


def _policy(inputs: Mapping[str, Tensor]) -> Mapping[str, Tensor]:
    return {"action": torch.sin(inputs["observation"])}


def _agent(perception: float, policy: float, control: float, rate: float = 120.0) -> AgentGraph:
    """x -> perception -> policy -> control -> command, with a second sum beside them."""
    wide = Port("observation", (2,))
    nodes = [
        Integrator("perception", perception),
        Concatenate("join", [Port("a", (1,)), Port("b", (1,))]),
        FunctionNode("policy", _policy, [wide], [Port("action", (2,))], policy),
        FunctionNode("head", lambda v: {"x": v["action"][:, :1]}, [Port("action", (2,))], [SCALAR]),
        Integrator("control", control),
        Integrator("beside", perception),
    ]
    edges = [
        Edge("x", "perception.x"),
        Edge("x", "beside.x"),
        Edge("perception.sum", "join.a"),
        Edge("x", "join.b"),
        Edge("join.value", "policy.observation"),
        Edge("policy.action", "head.action"),
        Edge("head.x", "control.x"),
        Edge("control.sum", "command"),
        Edge("beside.sum", "note"),
    ]
    return AgentGraph(nodes, edges, rate, inputs=[SCALAR], outputs=[Port("command", (1,)), Port("note", (1,))])


def _chain(rate: float) -> tuple[AgentGraph, Integrator]:
    node = Integrator("sum", rate)
    edges = [Edge("x", "sum.x"), Edge("sum.sum", "y")]
    return AgentGraph([node], edges, 100.0, inputs=[SCALAR], outputs=[Port("y", (1,))]), node


def _rows(*values: float) -> Tensor:
    return torch.tensor(values)[:, None]


def test_a_slow_node_holds_its_outputs() -> None:
    graph, node = _chain(25.0)
    outputs = [graph.step({"x": torch.ones(ENVIRONMENTS, 1)})["y"][0, 0].item() for _ in range(9)]
    assert outputs == [1.0, 1.0, 1.0, 1.0, 2.0, 2.0, 2.0, 2.0, 3.0]
    assert node.turns == 3


def test_a_reset_environment_gets_a_fresh_value_before_the_nodes_turn() -> None:
    graph, _ = _chain(25.0)
    one = torch.ones(ENVIRONMENTS, 1)
    for _ in range(4):
        graph.step({"x": one})
    held = graph.step({"x": one})["y"]
    assert torch.equal(held, _rows(2.0, 2.0, 2.0))
    graph.reset(torch.tensor([1]))
    renewed = graph.step({"x": 10.0 * one})["y"]
    assert torch.equal(renewed, _rows(2.0, 10.0, 2.0))
    assert torch.equal(held, _rows(2.0, 2.0, 2.0)), "what a step returned does not change later"
    graph.step({"x": 100.0 * one})
    graph.step({"x": 100.0 * one})
    # The renewal was no turn for the others: their sums go on from 2.
    assert torch.equal(graph.step({"x": one})["y"], _rows(3.0, 11.0, 3.0))


def test_resetting_all_starts_the_schedule_anew() -> None:
    graph, node = _chain(25.0)
    one = torch.ones(ENVIRONMENTS, 1)
    graph.step({"x": one})
    graph.reset()
    assert graph.step_count == 0
    assert torch.equal(graph.step({"x": 5.0 * one})["y"], _rows(5.0, 5.0, 5.0))
    assert node.turns == 2


def test_a_node_without_outputs_waits_for_its_turn() -> None:
    seen: list[int] = []

    def act(values: Mapping[str, Tensor]) -> Mapping[str, Tensor]:
        seen.append(graph.step_count)
        return {}

    graph = AgentGraph([FunctionNode("act", act, [SCALAR], rate=50.0)], [Edge("x", "act.x")], 100.0, inputs=[SCALAR])
    for _ in range(4):
        graph.step({"x": torch.ones(ENVIRONMENTS, 1)})
        graph.reset(torch.tensor([0]))
    assert seen == [0, 2]


@settings(max_examples=25, deadline=None)
@given(
    rates=st.tuples(*[st.sampled_from([120.0, 60.0, 40.0, 30.0])] * 3),
    resets=st.lists(st.sets(st.integers(0, ENVIRONMENTS - 1)), min_size=14, max_size=14),
    seed=st.integers(0, 1000),
)
def test_the_cut_graph_does_what_the_whole_does(
    rates: tuple[float, float, float], resets: list[set[int]], seed: int
) -> None:
    whole, parts = _agent(*rates), _agent(*rates)
    cut = Cut(parts, "policy")
    generator = torch.Generator().manual_seed(seed)
    for done in resets:
        x = torch.randn(ENVIRONMENTS, 1, generator=generator)
        observation = cut.observe({"x": x})
        if done:  # an environment resets after its last observation, then observes anew
            env_ids = torch.tensor(sorted(done))
            whole.reset(env_ids)
            parts.reset(env_ids)
            observation = cut.observe({"x": x})
        expected = whole.step({"x": x})
        got = cut.act(_policy(observation))
        assert torch.equal(got["note"], expected["note"])
        assert torch.equal(got["command"], expected["command"])


def test_an_environment_is_alone_whatever_happens_to_others() -> None:
    """Resets of environment 0 at odd times leave no trace in the others."""
    disturbed, calm = _agent(40.0, 30.0, 60.0), _agent(40.0, 30.0, 60.0)
    generator = torch.Generator().manual_seed(3)
    for step in range(30):
        x = torch.randn(ENVIRONMENTS, 1, generator=generator)
        if step % 4 == 3 or step % 7 == 2:
            disturbed.reset(torch.tensor([0]))
        one, other = disturbed.step({"x": x}), calm.step({"x": x})
        assert torch.equal(one["command"][1:], other["command"][1:])
        assert torch.equal(one["note"][1:], other["note"][1:])


def test_observing_twice_runs_nothing_twice() -> None:
    graph = _agent(120.0, 120.0, 120.0)
    cut = Cut(graph, "policy")
    perception = graph.nodes["perception"]
    assert isinstance(perception, Integrator)
    one = torch.ones(ENVIRONMENTS, 1)
    first = {name: value.clone() for name, value in cut.observe({"x": one}).items()}
    again = cut.observe({"x": one})
    assert perception.turns == 1
    assert torch.equal(first["observation"], again["observation"])


def test_the_cut_checks_what_it_is_given() -> None:
    cut = Cut(_agent(60.0, 120.0, 120.0), "policy")
    action = {"action": torch.zeros(ENVIRONMENTS, 2)}
    with pytest.raises(ConfigurationError, match="observe, then act"):
        cut.act(action)
    cut.observe({"x": torch.ones(ENVIRONMENTS, 1)})
    with pytest.raises(ConfigurationError, match="output of 'policy' 'action' is missing"):
        cut.act({"actions": action["action"]})
    with pytest.raises(ShapeError, match=r"'action' must have shape \(num_envs, 2\), not \(3, 1\)"):
        cut.act({"action": torch.zeros(ENVIRONMENTS, 1)})
    with pytest.raises(ConfigurationError, match="'policy' is due"):
        cut.act()
    cut.act(action)
    with pytest.raises(ConfigurationError, match="observe, then act"):
        cut.act(action)


def test_a_slow_policy_holds_its_action() -> None:
    cut = Cut(_agent(120.0, 60.0, 120.0), "policy")
    x = torch.ones(ENVIRONMENTS, 1)
    due = []
    for _ in range(4):
        observation = cut.observe({"x": x})
        due.append(cut.due)
        cut.act(_policy(observation) if cut.due else None)
    assert due == [True, False, True, False]


def test_external_values_are_checked() -> None:
    graph, _ = _chain(100.0)
    with pytest.raises(ConfigurationError, match="the graph's input 'x' is missing"):
        graph.step({})
    with pytest.raises(ShapeError, match=r"input 'x' must have shape \(num_envs, 1\), not \(3, 4\)"):
        graph.step({"x": torch.zeros(ENVIRONMENTS, 4)})


def test_a_node_that_breaks_its_word_is_named() -> None:
    wrong = FunctionNode("wrong", lambda v: {"y": torch.zeros(ENVIRONMENTS, 3)}, [], [Port("y", (2,))])
    with pytest.raises(ShapeError, match="output of node 'wrong' 'y' must have shape"):
        AgentGraph([wrong], [], 10.0).step()


def test_a_snapshot_repeats_the_continuation() -> None:
    graph = _agent(40.0, 30.0, 60.0)
    inputs = torch.randn(20, ENVIRONMENTS, 1, generator=torch.Generator().manual_seed(1))
    for x in inputs[:7]:
        graph.step({"x": x})
    graph.reset(torch.tensor([2]))
    state = graph.save_state()
    first = [{name: value.clone() for name, value in graph.step({"x": x}).items()} for x in inputs[7:]]
    graph.load_state(state)
    second = [{name: value.clone() for name, value in graph.step({"x": x}).items()} for x in inputs[7:]]
    for one, other in zip(first, second, strict=True):
        assert torch.equal(one["command"], other["command"])
        assert torch.equal(one["note"], other["note"])
