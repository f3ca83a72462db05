"""Robots on a grid of terrain: which cell each starts on, and a curriculum that moves them between its levels.

After Rudin et al., Learning to Walk in Minutes Using Massively Parallel Deep Reinforcement Learning (2021), section
2.2.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import cast

import torch
from torch import Tensor

from orbit_assets.terrain import TerrainGrid
from orbit_core.dynamics.kinematics import KinematicTree
from orbit_core.envs.task import Task
from orbit_core.envs.terms import TermFunction
from orbit_core.interfaces import ConfigurationError, Robot, World
from orbit_core.mdp import common

_GOLDEN = 0.618034
"""Multiples of the golden ratio, whole parts left out, are spread evenly however many there are."""
_NEAR_HOME = common.randomize_robot_start(0.05)


@dataclass(kw_only=True)
class OnTerrain:
    """What a task adds to its own whose robot walks on a grid of terrain. Derive from the task first, then from this.

    Its scene's terrain is ``self.terrain.shapes()``, and its ``start`` calls :meth:`start_on_terrain`;
    :func:`place_on_terrain` is its event, :func:`by_distance` its curriculum. Without a curriculum each episode draws
    its level.
    """

    curriculum_enabled: bool = False
    episode_length: float = 20.0
    difficulty: Tensor = field(init=False)
    terrain: TerrainGrid = field(default_factory=lambda: TerrainGrid(border=20.0))
    cell_origins: Tensor = field(init=False)
    """(levels, kinds, 3) where robots start, in the environment's frame."""
    kind: Tensor = field(init=False)
    """(N,) int64: an environment keeps its kind of terrain."""
    level: Tensor = field(init=False)
    """(N,) int64 of the present episode."""
    spare_level: Tensor = field(init=False)
    """(N,) int64 drawn anew for each episode: where a robot goes on that has walked off the last level."""

    def start_on_terrain(self, world: World) -> None:
        """Look up the cells, and see that the robot fits; a curriculum starts in the easier half of the levels.

        Raises:
            ConfigurationError: the robot is larger than a cell, or there is a curriculum and but one level.
        """
        robot, grid = common.robot_of(world), self.terrain
        grid.check_fits(robot.spec, standing_reach(robot))
        if self.curriculum_enabled and grid.levels < 2:
            raise ConfigurationError(
                "a curriculum of terrain needs levels to move robots between, and terrain.levels is 1: give 2 or more, "
                "or leave curriculum_enabled out"
            )
        count = torch.arange(world.num_envs, device=world.device)
        self.cell_origins = torch.tensor(grid.origins, dtype=torch.float32, device=world.device)
        self.kind = count % len(grid.kinds)
        self.level, self.spare_level = torch.zeros_like(count), torch.zeros_like(count)
        if self.curriculum_enabled:
            self.difficulty = 0.5 * ((count // len(grid.kinds) * _GOLDEN) % 1.0)


def standing_reach(robot: Robot) -> float:
    """Horizontal distance in metres from the root to the farthest foot, in the home pose."""
    tree = KinematicTree(robot.spec.articulation, robot.home_positions.device)
    root = torch.zeros(1, 7, device=robot.home_positions.device)
    root[:, 3] = 1.0
    poses = tree.forward(root, robot.home_positions.view(1, -1))
    feet = torch.stack([tree.frame_pose(poses, foot)[0, :2] for foot in robot.spec.feet])
    return float(feet.norm(dim=1).max())


def place_on_terrain(world: World, task: OnTerrain, env_ids: Tensor) -> None:
    """Event: stand the robot on its cell, at its home height above it, facing anywhere.

    The level follows the difficulty where a curriculum sets that, else each episode draws one.
    """
    robot, last = common.robot_of(world), task.terrain.levels - 1
    drawn = world.random.integers(0, last, env_ids)
    level = (task.difficulty[env_ids] * last).round().to(torch.int64) if task.curriculum_enabled else drawn
    task.level[env_ids], task.spare_level[env_ids] = level, drawn
    home = torch.tensor(robot.spec.pose.position, device=world.device)
    position = task.cell_origins[level, task.kind[env_ids]] + home
    common.stand_facing_anywhere(world, position, env_ids)
    _NEAR_HOME(world, cast(Task, task), env_ids)


def walked(world: World, task: OnTerrain) -> Tensor:
    """(N,) metres between the robot and the middle of its cell, seen from above."""
    middle = task.cell_origins[task.level, task.kind]
    return (common.robot_of(world).root_pose[:, :2] - middle[:, :2]).norm(dim=1)


def by_distance(command: TermFunction, share: float = 0.5) -> TermFunction:
    """A curriculum's change: a level up for who has left its cell, one down for who fell short of its command.

    Who leaves the last level goes on at any.

    Args:
        command: (N, 2 or more) the velocity in m/s that was asked for, forward and to the left, of a robot that keeps
            its heading.
        share: of the way that the command would have led in a whole episode; who walked less goes down.
    """

    def change(world: World, task: OnTerrain) -> Tensor:
        last = task.terrain.levels - 1
        distance = walked(world, task)
        up = distance > 0.5 * task.terrain.cell_size
        asked = share * task.episode_length * command(world, task)[:, :2].norm(dim=1)
        down = ~up & (distance < asked)
        following = (task.level + up.long() - down.long()).clamp_min(0)
        following = torch.where(following > last, task.spare_level, following)
        return following / last - task.difficulty

    return change
