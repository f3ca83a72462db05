"""The end of an environment's agent: from the policy's action to the targets of the joints of the robots that act."""

from __future__ import annotations

from collections.abc import Iterable, Mapping

from torch import Tensor

from orbit_core.actions import ActionTerm, Actuate, MotionGenerator
from orbit_core.agent import Edge, FunctionNode
from orbit_core.envs.state import TaskState
from orbit_core.envs.task import COMPOSED, Task
from orbit_core.interfaces import ConfigurationError, Node, Port, World

_SPLIT = "split"


class ActionManager:
    """Motion generators of the robots that act, and the agent of each component of the action.

    Args:
        world: that the robots are in.
        task: whose robots act.
        terms: of the task, by name, :func:`orbit_core.envs.action_terms.action_terms`.

    Raises:
        ConfigurationError: a generator takes another number of components than its term names.
    """

    def __init__(self, world: World, task: Task, terms: Mapping[str, ActionTerm]) -> None:
        if task.actions is not None:
            task.action = COMPOSED
        self.terms = terms
        self.generators = tuple(_built(world, task, name, term) for name, term in terms.items())
        """Motion generators in the order of the action's components."""
        self.slices = _slices_by_agent(self.generators)
        """Which components of the action are each agent's."""
        named = {name: term.components(world.robots[term.robot].spec, name) for name, term in terms.items()}
        self.components = tuple(f"{name}: {component}" for name, own in named.items() for component in own)
        """Name of each component of the action: of its term, then its own."""
        self.size = sum(generator.command_size for generator in self.generators)
        """Components of the action."""
        self._sizes = [generator.command_size for generator in self.generators]
        self._commands = tuple(Port(generator.name, (generator.command_size,)) for generator in self.generators)
        self._actuators = [Actuate(generator.robot, generator) for generator in self.generators]
        self._state: TaskState | None = None

    def attach(self, state: TaskState) -> None:
        """Take the state whose ``last_action`` and ``action_before`` are written when an action is applied."""
        self._state = state

    @property
    def nodes(self) -> list[Node]:
        """The tail of the agent's graph: each generator gets its part of the action, and its joints their targets."""
        action = Port("action", (self.size,))
        split = FunctionNode(_SPLIT, self._split, inputs=(action,), outputs=self._commands)
        return [split, *self.generators, *self._actuators]

    def edges(self, source: str) -> list[Edge]:
        """What connects :attr:`nodes` with each other, and with the output port ``source`` that gives the action."""
        edges = [Edge(source, f"{_SPLIT}.action")]
        for generator, actuate in zip(self.generators, self._actuators, strict=True):
            edges.append(Edge(f"{_SPLIT}.{generator.name}", f"{generator.name}.command"))
            edges += [Edge(f"{generator.name}.{port.name}", f"{actuate.name}.{port.name}") for port in actuate.inputs]
        return edges

    def _split(self, inputs: Mapping[str, Tensor]) -> Mapping[str, Tensor]:
        action = inputs["action"]
        state = self._state
        assert state is not None  # attached before the first step
        state.action_before.copy_(state.last_action)
        state.last_action.copy_(action)
        parts = action.split_with_sizes(self._sizes, dim=1)
        return {port.name: part for port, part in zip(self._commands, parts, strict=True)}


def _built(world: World, task: Task, name: str, term: ActionTerm) -> MotionGenerator:
    robot = world.robots[term.robot]
    generator = term.build(name, robot)
    named = term.components(robot.spec, name)
    if generator.command_size != len(named):
        raise ConfigurationError(
            f"action term '{name}' names {len(named)} components ({', '.join(named)}), but its generator takes "
            f"{generator.command_size}: mend {type(term).__name__}.components"
        )
    generator.enter(world, task.physics_dt * task.decimation)
    return generator


def _slices_by_agent(generators: Iterable[MotionGenerator]) -> dict[str, slice]:
    slices: dict[str, slice] = {}
    end = 0
    for generator in generators:
        begin, end = end, end + generator.command_size
        agent = generator.robot.name
        slices[agent] = slice(slices[agent].start if agent in slices else begin, end)
    return slices
