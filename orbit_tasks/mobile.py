"""Base of tasks of arms on bases: how the base is moved and placed, and where it stands to use its arm."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np
import torch
from torch import Tensor

from orbit_assets.audit.checks import shape_points
from orbit_core.actions import ActionTerm, preset_terms
from orbit_core.actions.embodiment import arm_joints_of
from orbit_core.dynamics.transforms import quat_rotate
from orbit_core.envs import Environment
from orbit_core.envs.terms import POSE, EventFunction, TermFunction, measured_in, once_per_state
from orbit_core.interfaces import ConfigurationError, World
from orbit_core.mdp import common
from orbit_core.scene import RobotSpec, Scene
from orbit_motion import workspace as task_robots
from orbit_tasks.locomotion import LocomotionConfig
from orbit_tasks.surroundings import surrounded

# The action term that moves a walking robot; other bases' terms are of that name too.
BASE = "base"


def mobile(name: str, gripper: bool = True) -> RobotSpec:
    """A robot of the catalogue with an arm on a base that drives or walks, as the task's robot.

    Raises:
        UnknownNameError: there is none of that name.
        ConfigurationError: it has no base that moves, no arm, or no gripper where one is needed.
    """
    spec = task_robots.arm(name, gripper)
    if spec.planar_base is None and spec.differential_base is None and not spec.feet:
        raise ConfigurationError(
            f"robot '{name}' has no base that moves, which this task needs: mount it on one, as in 'base_omni+{name}', "
            "or choose another robot"
        )
    return spec


@measured_in(POSE)
@once_per_state
def base_pose(env: Environment) -> Tensor:
    """(N, 7) of the link that carries the arm, in the environment's frame."""
    robot = common.robot_of(env.world)
    return robot.link_poses[:, robot.link_names.index(robot.spec.base_link)]


def tipped(env: Environment) -> Tensor:
    """(N,) bool: the base leans by more than 60 degrees."""
    up = torch.tensor([0.0, 0.0, 1.0], device=env.device)
    pose = base_pose(env)
    # The height of the up axis is the cosine of the lean.
    return quat_rotate(pose[:, 3:], up.expand(len(pose), 3))[:, 2] < 0.5


def stand_at(world: World, place: Tensor, env_ids: Tensor) -> None:
    """Put the robot's base to places (n, 3), x and y in m and heading in rad, its joints where they are."""
    robot = common.robot_of(world)
    base = robot.spec.planar_base
    # A planar base is three joints of the robot, and only other bases move with the root.
    if base is not None:
        robot.set_joint_state(place, joints=robot.find_joints(base.x, base.y, base.yaw), env_ids=env_ids)
        return
    height = torch.full_like(place[:, :1], robot.spec.pose.position[2])
    robot.set_root_pose(common.standing(torch.cat((place[:, :2], height, place[:, 2:]), dim=1)), env_ids)


def start_within(low: tuple[float, float], high: tuple[float, float], spread: float = 0.05) -> EventFunction:
    """Event: the base anywhere between two corners (m), facing anywhere; the joints of the arm around their home."""
    around = common.randomize_robot_start(spread)

    def place(env: Environment, env_ids: Tensor) -> None:
        around(env, env_ids)
        stand_at(env.world, env.world.random.uniform((3,), (*low, -math.pi), (*high, math.pi), env_ids), env_ids)

    return place


def start_in_ring(middle: tuple[float, float], radii: tuple[float, float], spread: float = 0.05) -> EventFunction:
    """Event: the base in any direction from a middle, at a distance between two (m), facing anywhere; the joints of
    the arm around their home."""
    around = common.randomize_robot_start(spread)

    def place(env: Environment, env_ids: Tensor) -> None:
        around(env, env_ids)
        bounds = (radii[0], -math.pi, -math.pi), (radii[1], math.pi, math.pi)
        distance, bearing, heading = env.world.random.uniform((3,), *bounds, env_ids).unbind(1)
        # Distance and bearing are drawn evenly, so that near places are as frequent as far ones.
        x, y = middle[0] + distance * bearing.cos(), middle[1] + distance * bearing.sin()
        stand_at(env.world, torch.stack((x, y, heading), 1), env_ids)

    return place


def base_radius(robot: RobotSpec) -> float:
    """Metres that paths keep free around the middle of the base: a circle around its shapes as seen from above.

    Raises:
        ConfigurationError: nothing of the base collides.
    """
    link = next(each for each in robot.articulation.links if each.name == robot.base_link)
    clouds = [cloud for shape in link.collisions if len(cloud := shape_points(shape))]
    if not clouds:
        raise ConfigurationError(f"the base of robot '{robot.name}' has no shapes that could be kept off things")
    # A circle, because a base turns on its way, and its corners must then be free as well.
    return max(float(np.linalg.norm(cloud[:, :2], axis=1).max()) for cloud in clouds)


def ahead_of(place: Tensor, distance: float | Tensor) -> Tensor:
    """(N, 3) of the base, which faces along ``place`` (N, 3), that distance (m) behind it."""
    heading = place[:, 2]
    back = torch.stack((heading.cos(), heading.sin()), 1) * distance
    return torch.cat((place[:, :2] - back, heading[:, None]), 1)


def over_floor(pose: Tensor) -> Tensor:
    """(N, 3) x, y and heading of poses (N, 7): where their x axis points, or for a hand that points down its x axis."""
    ahead = quat_rotate(pose[:, 3:], torch.tensor([1.0, 0.0, 0.0], device=pose.device).expand(len(pose), 3))
    return torch.cat((pose[:, :2], torch.atan2(ahead[:, 1], ahead[:, 0])[:, None]), 1)


def reach_ahead(world: World) -> float:
    """Metres ahead of the base to the middle of the hand's workspace."""
    low, high = common.workspace(world)
    return 0.5 * (low[0] + high[0])


def near_to(target: TermFunction, scale: float) -> TermFunction:
    """Reward (N,) in [0, 1]: how near the hand is to what is to be reached (N, 3 or more), over metres and not over
    centimetres."""

    def near(env: Environment) -> Tensor:
        way = target(env)[:, :3] - common.hand_position(env)
        return common.nearness(torch.linalg.vector_norm(way, dim=1), scale)

    return near


@dataclass(kw_only=True)
class Mobile:
    """Fields of a task for an arm on a base: derive from this first, and then from the task.

    The action space's own terms move the arm, and a term ``base`` the base: by its own velocities, or, where it walks,
    by a kept policy that follows them.
    """

    robot: str = "base_omni_franka_panda"
    """Name of a robot in the catalogue whose base drives or walks."""
    gait: str = "velocity_flat"
    """Kept policy, or path of one, that walks a robot on legs (:class:`~orbit_tasks.locomotion.LocomotionConfig`)."""
    walking_speed: float = 0.5
    """m/s forward at which a robot on legs is led; half of it sideways, and as much in rad/s."""
    surroundings: str = ""
    """USD or MJCF file of a room whose fixed objects stand around the task, such as ``orbit scene scan`` writes."""
    surroundings_place: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """x and y in m and heading in rad of that room's origin in the environment's frame."""

    def in_surroundings(self, scene: Scene) -> Scene:
        """Return the task's scene, in the room of the file if one is named."""
        return surrounded(scene, self.surroundings, self.surroundings_place) if self.surroundings else scene

    def preset_terms(self: Walking, spec: RobotSpec, prefix: str) -> dict[str, ActionTerm]:
        """Return action terms, see :meth:`orbit_core.envs.Task.preset_terms`."""
        if not spec.feet:
            return preset_terms(spec, self.action, prefix)
        # As if the arm stood on a bench: the legs are the base's.
        terms = preset_terms(replace(spec, feet=()), self.action, prefix)
        first = next(iter(terms))
        if terms[first].joints is None:
            terms[first] = replace(terms[first], joints=arm_joints_of(spec))
        speed = self.walking_speed
        walk = LocomotionConfig(
            robot=spec.name,
            policy=self.gait,
            max_forward=speed,
            max_sideways=0.5 * speed,
            max_yaw_rate=0.8,
        )
        return {**terms, prefix + BASE: walk}


class Walking(Protocol):
    """Protocol of the task that :class:`Mobile` extends."""

    action: str
    """Name of the action space of the arm."""
    gait: str
    """Kept policy that walks a robot on legs."""
    walking_speed: float
    """m/s forward at which a robot on legs is led."""


def sag_rate(world: World) -> float:
    """1/s for an expert: nothing where the robot's controller cancels its arm's weight."""
    return 0.0 if common.robot_of(world).spec.gravity_compensation else 1.0
