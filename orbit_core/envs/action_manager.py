"""The end of an environment's agent: from the policy's action to the targets of the joints of the robots that act."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import replace

from torch import Tensor

from orbit_core.agent import Edge, FunctionNode
from orbit_core.envs.task import Task
from orbit_core.interfaces import Node, Port, UnknownNameError, World
from orbit_core.motion import Actuate, MotionGenerator, action_space, with_drives_for
from orbit_core.scene import Scene

_SPLIT = "split"


class ActionManager:
    """What moves the robots of a task, and whose each component of the action is.

    The task is told its ``generators`` and ``action_slices``.

    Args:
        world: that the robots are in.
        task: whose robots act.
    """

    def __init__(self, world: World, task: Task) -> None:
        self._task = task
        self.generators = task.generators = _generators_of(world, task)
        """In the order of the action's components."""
        self.slices = task.action_slices = _slices_by_agent(self.generators)
        """Which components of the action are each agent's."""
        self.size = sum(generator.command_size for generator in self.generators)
        """Components of the action."""
        self._sizes = [generator.command_size for generator in self.generators]
        self._commands = tuple(Port(generator.name, (generator.command_size,)) for generator in self.generators)
        self._actuators = [Actuate(generator.robot, generator) for generator in self.generators]

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
        self._task.action_before.copy_(self._task.last_action)
        self._task.last_action.copy_(action)
        parts = action.split_with_sizes(self._sizes, dim=1)
        return {port.name: part for port, part in zip(self._commands, parts, strict=True)}


def driven_scene(task: Task) -> Scene:
    """The task's scene with those that act driven as the action space needs it.

    Raises:
        UnknownNameError: the scene lacks one of them.
    """
    scene = task.scene()
    names = [spec.name for spec in scene.robots]
    for agent in task.agents:
        if agent not in names:
            raise UnknownNameError("robot", agent, names, f"the scene of task {type(task).__name__}, where it acts")
    robots = tuple(with_drives_for(spec, task.action) if spec.name in task.agents else spec for spec in scene.robots)
    return replace(scene, robots=robots)


def _generators_of(world: World, task: Task) -> tuple[MotionGenerator, ...]:
    """What moves the agents, one after another; where there are several, with the agent's name before its own."""
    several = len(task.agents) > 1
    return tuple(
        generator
        for agent in task.agents
        for generator in action_space(world.robots[agent], task.action, f"{agent}_" if several else "")
    )


def _slices_by_agent(generators: Iterable[MotionGenerator]) -> dict[str, slice]:
    slices: dict[str, slice] = {}
    end = 0
    for generator in generators:
        begin, end = end, end + generator.command_size
        agent = generator.robot.name
        slices[agent] = slice(slices[agent].start if agent in slices else begin, end)
    return slices
