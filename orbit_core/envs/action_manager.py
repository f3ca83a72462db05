"""The robots that act in a task: their drives, what moves them, and whose each component of the action is."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace

from orbit_core.envs.task import Task
from orbit_core.interfaces import UnknownNameError, World
from orbit_core.motion import MotionGenerator, action_space, with_drives_for
from orbit_core.scene import Scene


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


def generators_of(world: World, task: Task) -> tuple[MotionGenerator, ...]:
    """What moves the agents, one after another; where there are several, with the agent's name before its own."""
    several = len(task.agents) > 1
    return tuple(
        generator
        for agent in task.agents
        for generator in action_space(world.robots[agent], task.action, f"{agent}_" if several else "")
    )


def action_parts(generators: Iterable[MotionGenerator]) -> dict[str, slice]:
    """Which components of the action are each agent's."""
    parts: dict[str, slice] = {}
    end = 0
    for generator in generators:
        begin, end = end, end + generator.command_size
        agent = generator.robot.name
        parts[agent] = slice(parts[agent].start if agent in parts else begin, end)
    return parts
