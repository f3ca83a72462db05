"""The graph cut at a node: what comes before it is an observation, what comes after it is part of acting."""

from __future__ import annotations

from collections.abc import Mapping

from torch import Tensor

from orbit_core.agent.graph import AgentGraph
from orbit_core.interfaces import ConfigurationError, find_name


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
        before = graph.wiring.ancestors(name)
        self._upstream = [runner for runner in graph.runners if runner.node.name in before]
        self._downstream = [runner for runner in graph.runners if runner.node.name not in (*before, name)]
        (self._replaced,) = (runner for runner in graph.runners if runner.node is self.node)
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
        """Whether new outputs count for all environments at this step; a node slower than the agent holds them."""
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
