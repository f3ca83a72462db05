"""The end of an environment's agent: from the policy's action to the targets of the joints of the robots that act."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable, Mapping
from dataclasses import replace

import torch
from torch import Tensor

from orbit_core.actions import ActionTerm, Actuate, MotionGenerator, with_drives_for
from orbit_core.agent import AgentGraph, Edge, FunctionNode
from orbit_core.agent.graph import checked
from orbit_core.envs.state import TaskState
from orbit_core.envs.task import COMPOSED, Task
from orbit_core.envs.terms import terms_of
from orbit_core.interfaces import ConfigurationError, JointTarget, Node, Port, UnknownNameError, World
from orbit_core.interfaces.capture import Schedule
from orbit_core.scene import RobotSpec, Scene

# Action terms of a task, found in its scene before anything is built, and checked -------------------------------------


def action_terms(task: Task, scene: Scene) -> dict[str, ActionTerm]:
    """The task's action terms by name, robot by robot in the order of ``agents``: the order of the action's components.

    They are those of ``actions``; where that is None, those of the preset that ``action`` names, for each agent, with
    the agent's name before the terms' own where there are several.

    Args:
        task: that acts.
        scene: of the task.

    Raises:
        UnknownNameError: the scene lacks a robot, the robot a joint, or there is no such action space.
        ConfigurationError: a joint belongs to two terms; an agent has no term, or a term's robot is no agent; a robot
            lacks what a term moves; or both ``action`` and ``actions`` say what is to be.
    """
    specs = _specs_of_agents(task, scene)
    terms = _preset(task, specs) if task.actions is None else _composed(task, scene)
    _check_disjoint(terms, specs)
    return terms


def driven_scene(scene: Scene, terms: Mapping[str, ActionTerm]) -> Scene:
    """The scene with robots whose drives suit their action terms, by name."""
    robots = tuple(
        with_drives_for(spec, {name: term for name, term in terms.items() if term.robot == spec.name})
        for spec in scene.robots
    )
    return replace(scene, robots=robots)


def _specs_of_agents(task: Task, scene: Scene) -> dict[str, RobotSpec]:
    specs = {spec.name: spec for spec in scene.robots}
    for agent in task.agents:
        if agent not in specs:
            raise UnknownNameError("robot", agent, specs, f"the scene of task {type(task).__name__}, where it acts")
    return {agent: specs[agent] for agent in task.agents}


def _preset(task: Task, specs: Mapping[str, RobotSpec]) -> dict[str, ActionTerm]:
    if task.action == COMPOSED:
        raise ConfigurationError(
            f"task {type(task).__name__} has no action terms of its own: set actions=ActionTerms(...), or name an "
            "action space"
        )
    several = len(specs) > 1
    parts = [task.preset_terms(spec, f"{agent}_" if several else "") for agent, spec in specs.items()]
    return {name: term for part in parts for name, term in part.items()}


def _composed(task: Task, scene: Scene) -> dict[str, ActionTerm]:
    kind = type(task).__name__
    if not dataclasses.is_dataclass(task.actions) or isinstance(task.actions, type):
        raise ConfigurationError(
            f"actions of task {kind} are a dataclass of action terms, such as ActionTerms(arm=...), not "
            f"{task.actions!r}"
        )
    default = type(task).__dataclass_fields__["action"].default
    if task.action not in (default, COMPOSED):
        raise ConfigurationError(
            f"task {kind} is composed of action terms, and action '{task.action}' would change nothing: leave it out, "
            "or set actions to None"
        )
    try:
        terms = terms_of(task.actions, ActionTerm)
    except TypeError as error:
        raise ConfigurationError(f"actions of task {kind}: {error}") from None
    present = [spec.name for spec in scene.robots]
    for name, term in terms.items():
        if term.robot not in present:
            raise UnknownNameError("robot", term.robot, present, f"action term '{name}' of task {kind}")
        if term.robot not in task.agents:
            raise ConfigurationError(
                f"action term '{name}' moves robot '{term.robot}', which does not act in task {kind}: name it in agents"
            )
    for agent in task.agents:
        if agent not in [term.robot for term in terms.values()]:
            raise ConfigurationError(f"no action term of task {kind} moves robot '{agent}', which is one of its agents")
    order = [*task.agents]
    return dict(sorted(terms.items(), key=lambda item: order.index(item[1].robot)))


def _check_disjoint(terms: Mapping[str, ActionTerm], specs: Mapping[str, RobotSpec]) -> None:
    owners: dict[tuple[str, int], str] = {}
    for name, term in terms.items():
        spec = specs[term.robot]
        for joint in term.joint_indices(spec, name):
            first = owners.setdefault((term.robot, joint), name)
            if first != name:
                raise ConfigurationError(
                    f"action terms '{first}' and '{name}' both move joint '{spec.articulation.joint_names[joint]}' of "
                    f"robot '{term.robot}': give one of them other joints"
                )


_SPLIT = "split"


class ActionManager:
    """Motion generators of the robots that act, and the agent of each component of the action.

    Args:
        world: that the robots are in.
        task: whose robots act.
        terms: of the task, by name, :func:`orbit_core.envs.action_manager.action_terms`.
        step_dt: s from one action to the next.

    Raises:
        ConfigurationError: a generator takes another number of components than its term names.
    """

    def __init__(self, world: World, task: Task, terms: Mapping[str, ActionTerm], step_dt: float) -> None:
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
        self.action = torch.zeros(world.num_envs, self.size, device=world.device)
        """(N, A) the action that :meth:`apply` takes; written in place."""
        parts = self.action.split_with_sizes(self._sizes, dim=1)
        self._drives = [_Drive(generator, part) for generator, part in zip(self.generators, parts, strict=True)]
        # The agent from the action on, where a generator has another rate than the agent; the others need no schedule.
        self._graph: AgentGraph | None = None
        if any(generator.rate is not None for generator in self.generators):
            given = Port("action", (self.size,))
            self._graph = AgentGraph(self.nodes, self.edges("action"), rate=1.0 / step_dt, inputs=(given,))

    def attach(self, state: TaskState) -> None:
        """Take the state whose ``last_action`` and ``action_before`` are written when an action is applied."""
        self._state = state

    def apply(self) -> None:
        """Run the motion generators on :attr:`action`, and write their targets to the joints."""
        if self._graph is not None:
            self._graph.step({"action": self.action})
            return
        state = self._state
        assert state is not None  # attached before the first step
        state.action_before.copy_(state.last_action)
        state.last_action.copy_(self.action)
        for drive in self._drives:
            outputs = drive.generator.compute(drive.inputs)
            if not drive.checked:
                drive.check(outputs)
            for name, write in drive.writers:
                write(outputs[name])

    def reset(self, env_ids: Tensor | None) -> None:
        """Make the generators forget some environments, by index or mask."""
        if self._graph is not None:
            self._graph.reset(env_ids)
        else:
            for generator in self.generators:
                generator.reset(env_ids)

    @property
    def schedule(self) -> Schedule | None:
        """Counters of the generators' turns; None where all take their turn in every step."""
        return None if self._graph is None else self._graph.schedule

    @property
    def node_memory(self) -> dict[str, dict[str, Tensor]]:
        """Tensors that generators keep from step to step, by name, for each generator."""
        return {f"node '{generator.name}'": dict(generator.memory()) for generator in self.generators}

    # For a graph of the whole agent

    @property
    def nodes(self) -> list[Node]:
        """Last nodes of the agent's graph: each generator gets its part of the action, and its joints their targets."""
        action = Port("action", (self.size,))
        split = FunctionNode(_SPLIT, self._split, inputs=(action,), outputs=self._commands)
        return [split, *self.generators, *self._actuators]

    def edges(self, source: str) -> list[Edge]:
        """Return the edges between :attr:`nodes`, and from the output port ``source`` that gives the action."""
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


class _Drive:
    """A motion generator, its part of the action, and where its targets go."""

    def __init__(self, generator: MotionGenerator, command: Tensor) -> None:
        self.generator = generator
        self.inputs = {"command": command}
        self.checked = False
        """True once the shapes of the generator's outputs were checked."""
        robot, joints = generator.robot, generator.joints
        # The action was checked at the environment's door, so targets that the generator clamps need no other look.
        self.writers = [
            (port.name, robot.target_writer(JointTarget(port.name), joints, checked=not generator.bounded))
            for port in generator.outputs
        ]

    def check(self, outputs: Mapping[str, Tensor]) -> None:
        """Check the shapes of the first outputs.

        Raises:
            ConfigurationError, ShapeError: an output is missing, or of another shape than its port.
        """
        for port in self.generator.outputs:
            checked(outputs, port, f"output of node '{self.generator.name}'")
        self.checked = True


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
