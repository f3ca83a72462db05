"""The base's part in an expert: it drives to where a phase wants it, and stays there in the phases that follow."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

import torch
from torch import Tensor

from orbit_core.dynamics.transforms import yaw_angle
from orbit_core.envs.task import Task
from orbit_core.interfaces import ConfigurationError, Robot
from orbit_motion.planning import BasePathFollower, BasePlanner, BasePlannerConfig

if TYPE_CHECKING:
    from orbit_core.actions.base import MotionGenerator
    from orbit_core.interfaces import World


# Metres from a place at which the next one is headed for. What a base on two wheels lacks then, it lacks for good.
_NEAR, _NEAR_ON_WHEELS = 0.1, 0.03


class DrivenBase:
    """Leads one robot's base to one place after another, in each environment by itself.

    Args:
        robot: that drives.
        generators: of the robot; one takes the velocity of its base.
        world: that the robot is in.
        task: that acts, for messages.
        planner: how paths are planned around what stands on the floor; None goes straight.

    Raises:
        ConfigurationError: no generator takes velocities of a base over the floor.
    """

    def __init__(
        self,
        robot: Robot,
        generators: Sequence[MotionGenerator],
        world: World,
        task: Task,
        planner: BasePlannerConfig | None,
    ) -> None:
        limits = [each.base_limits for each in generators if each.base_limits is not None]
        if not limits:
            raise ConfigurationError(
                f"the expert of task {type(task).__name__} drives a base by velocities over the floor, which action "
                f"'{task.action}' of robot '{task.robot}' does not take: choose another action space, such as "
                "joint_position, or another robot, such as base_omni_franka_panda"
            )
        sideways = bool(limits[0][1] > 0.0)
        self._components = slice(None) if sideways else slice(None, None, 2)
        tolerance = _NEAR if sideways else _NEAR_ON_WHEELS
        # Robots walk best ahead.
        face_way = bool(robot.spec.feet)
        self._follower = BasePathFollower(f"{robot.name}_base", robot, limits[0], tolerance, face_way=face_way)
        self._link = robot.link_names.index(robot.spec.base_link)
        self._robot, self._planner = robot, None if planner is None else BasePlanner(world, planner)
        self._target = torch.zeros(world.num_envs, 3, device=world.device)

    def begin(self, target: Tensor, rows: Tensor) -> None:
        """Drive to ``target`` (N, 3), x and y in m and heading in rad, in the environments of ``rows`` (N,) bool.

        Raises:
            PlanningError: something stands in the way.
        """
        env_ids = rows.nonzero().squeeze(-1)
        if not len(env_ids):
            return
        self._target[env_ids] = target[env_ids]
        here = self._robot.link_poses[:, self._link, :2]
        paths: dict[int, Tensor] = {}
        for env in env_ids.tolist():
            goal = target[env, :2]
            paths[env] = goal[None] if self._planner is None else self._planner.plan(here[env], goal, env)[1:]
        self._follower.load(paths, {env: float(target[env, 2]) for env in paths})

    def command(self) -> Tensor:
        """(N, 3), or (N, 2) on two wheels, that drives on, or keeps the base where it is to be."""
        return self._follower.compute({})["command"][:, self._components]

    @property
    def distances(self) -> Tensor:
        """(N, 2) m and rad from where the base was told to go; infinite as long as it is on its way there."""
        pose = self._robot.link_poses[:, self._link]
        away = torch.linalg.vector_norm(self._target[:, :2] - pose[:, :2], dim=1)
        turn = self._target[:, 2] - yaw_angle(pose[:, 3:])
        left = torch.stack((away, torch.atan2(turn.sin(), turn.cos()).abs()), 1)
        return torch.where(self._follower.finished[:, None], left, math.inf)

    def reset(self, env_ids: Tensor | None) -> None:
        """Stand still in some environments until a phase drives."""
        self._follower.reset(env_ids)

    def memory(self) -> Mapping[str, Tensor]:
        """For :meth:`orbit_core.interfaces.Node.memory`."""
        return {**self._follower.memory(), "target": self._target}
