"""Action terms of a task, found in its scene before anything is built, and checked."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from dataclasses import replace

from orbit_core.actions import ActionTerm, with_drives_for
from orbit_core.envs.task import COMPOSED, Task
from orbit_core.envs.terms import terms_of
from orbit_core.interfaces import ConfigurationError, UnknownNameError
from orbit_core.scene import RobotSpec, Scene


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
