"""Robots on a grid of terrain: which cell each starts on, and a curriculum that moves them between its levels.

After Rudin et al., Learning to Walk in Minutes Using Massively Parallel Deep Reinforcement Learning (2021), section
2.2.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import torch
from torch import Tensor

from orbit_assets.terrain import TerrainGrid
from orbit_core.dynamics.kinematics import KinematicTree
from orbit_core.envs import Environment
from orbit_core.envs.state import TaskState, buffer
from orbit_core.envs.terms import TermFunction
from orbit_core.interfaces import ConfigurationError, Robot
from orbit_core.mdp import common

# Multiples of the golden ratio, whole parts left out, are spread evenly however many there are.
_GOLDEN = 0.618034
_NEAR_HOME = common.randomize_robot_start(0.05)


@dataclass(kw_only=True)
class OnTerrain:
    """Configuration of a robot that walks on a grid of terrain. Derive a task from its own base first, then from this.

    Its scene's terrain is ``self.terrain.shapes()``, its state derives from :class:`TerrainMemory`;
    :func:`place_on_terrain` is its event, :func:`by_distance` its curriculum. Without a curriculum each episode draws
    its level.
    """

    curriculum_enabled: bool = False
    """Whether the curriculum moves robots between levels; else each episode draws its level."""
    episode_length: float = 20.0
    """Seconds; the next level depends on the way walked in them."""
    terrain: TerrainGrid = field(default_factory=lambda: TerrainGrid(border=20.0))
    """Levels and kinds of terrain; 20 m of plane around them, for robots that walk off."""


class TerrainMemory(TaskState):
    """State of robots on a grid of terrain. A state's ``start`` calls :meth:`start_on_terrain`."""

    cell_origins: Tensor
    """(levels, kinds, 3) where robots start, in the environment's frame."""
    kind: Tensor
    """(N,) int64: an environment keeps its kind of terrain."""
    level: Tensor = buffer(dtype=torch.int64)
    """(N,) int64 of the present episode."""
    spare_level: Tensor = buffer(dtype=torch.int64)
    """(N,) int64 drawn for each episode: where a robot goes on that has walked off the last level."""

    def start_on_terrain(self, env: Environment[Any]) -> None:
        """Look up the cells, and check that the robot fits; a curriculum starts in the easier half of the levels.

        Raises:
            ConfigurationError: the robot is larger than a cell, or there is a curriculum and but one level.
        """
        robot, grid = common.robot_of(env.world), env.task.terrain
        grid.check_fits(robot.spec, standing_reach(robot))
        if env.task.curriculum_enabled and grid.levels < 2:
            raise ConfigurationError(
                "a curriculum of terrain needs levels to move robots between, and terrain.levels is 1: give 2 or more, "
                "or leave curriculum_enabled out"
            )
        count = torch.arange(env.num_envs, device=env.device)
        self.cell_origins = torch.tensor(grid.origins, dtype=torch.float32, device=env.device)
        self.kind = count % len(grid.kinds)
        if env.task.curriculum_enabled:
            # Spread over the easier half, so that each kind of terrain has robots of several levels from the start.
            self.difficulty.copy_(0.5 * ((count // len(grid.kinds) * _GOLDEN) % 1.0))


def standing_reach(robot: Robot) -> float:
    """Horizontal distance in metres from the root to the farthest foot, in the home pose."""
    tree = KinematicTree(robot.spec.articulation, robot.home_positions.device)
    root = torch.zeros(1, 7, device=robot.home_positions.device)
    root[:, 3] = 1.0
    poses = tree.forward(root, robot.home_positions.view(1, -1))
    feet = torch.stack([tree.frame_pose(poses, foot)[0, :2] for foot in robot.spec.feet])
    return float(feet.norm(dim=1).max())


def place_on_terrain(env: Environment[Any, TerrainMemory], env_ids: Tensor) -> None:
    """Event: stand the robot on its cell, at its home height above it, facing anywhere.

    The level follows the difficulty where a curriculum sets that, else each episode draws one.
    """
    robot, last = common.robot_of(env.world), env.task.terrain.levels - 1
    drawn = env.world.random.integers(0, last, env_ids)
    level = (env.state.difficulty[env_ids] * last).round().to(torch.int64) if env.task.curriculum_enabled else drawn
    env.state.level[env_ids], env.state.spare_level[env_ids] = level, drawn
    home = torch.tensor(robot.spec.pose.position, device=env.device)
    position = env.state.cell_origins[level, env.state.kind[env_ids]] + home
    common.stand_facing_anywhere(env.world, position, env_ids)
    _NEAR_HOME(env, env_ids)


def walked(env: Environment[Any, TerrainMemory]) -> Tensor:
    """(N,) metres between the robot and the middle of its cell, seen from above."""
    middle = env.state.cell_origins[env.state.level, env.state.kind]
    return (common.robot_of(env.world).root_pose[:, :2] - middle[:, :2]).norm(dim=1)


def by_distance(command: TermFunction, share: float = 0.5) -> TermFunction:
    """A curriculum's change: a level up for who has left its cell, one down for who fell short of its command.

    Who leaves the last level goes on at any.

    Args:
        command: (N, 2 or more) the velocity in m/s that was asked for, forward and to the left, of a robot that keeps
            its heading.
        share: of the way that the command would have led in a whole episode; who walked less goes down.
    """

    def change(env: Environment[Any, TerrainMemory]) -> Tensor:
        last = env.task.terrain.levels - 1
        distance = walked(env)
        up = distance > 0.5 * env.task.terrain.cell_size
        asked = share * env.task.episode_length * command(env)[:, :2].norm(dim=1)
        # Who went up cannot go down: a fast command may ask for more than a cell's size.
        down = ~up & (distance < asked)
        following = (env.state.level + up.long() - down.long()).clamp_min(0)
        # Back to a random level, so that easy terrain is not forgotten.
        following = torch.where(following > last, env.state.spare_level, following)
        return following / last - env.state.difficulty

    return change
