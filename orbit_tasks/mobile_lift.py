"""Mobile-Lift: drive around a table to a cube, grasp it, and hold it at a sampled position."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any, ClassVar

import torch
from torch import Tensor

from orbit_assets.objects import table
from orbit_core.envs import EventTerm, ObservationTerm, RewardTerm, TerminationTerm
from orbit_core.interfaces import World
from orbit_core.mdp import common
from orbit_core.scene import Pose, RobotSpec, Scene, look_at
from orbit_motion.experts import Expert, Phase
from orbit_motion.planning import BasePlannerConfig
from orbit_tasks.lift import (
    GOAL,
    Lift,
    LiftEvents,
    LiftObservations,
    LiftPixelObservations,
    LiftRewards,
    LiftState,
    LiftTerminations,
    at_cube,
    at_goal,
    cube_pose,
)
from orbit_tasks.mdp import picking
from orbit_tasks.mobile import Mobile, base_pose, base_radius, mobile, near_to, sag_rate, start_in_ring, tipped

DEPTH, WIDTH = 0.6, 1.4
"""Metres of the table along x and y."""
TABLE = (1.5, 0.0)
"""Where its middle is."""
EDGE = TABLE[0] - 0.5 * DEPTH
"""x in m of the side at which the cube lies."""
RING = (1.5, 2.3)
"""Metres from the middle of the table to where the base starts."""
SIDEWAYS, LEGS = 0.45, 0.4
"""Metres from the middle of the side within which cube and goal are; and what a base keeps off its ends."""


def place_cube(world: World, task: MobileLift, env_ids: Tensor) -> None:
    """Place the cube along the side of the table, turned by any angle."""
    (near, far), height = task.patch, task.surface + task.rest_height
    bounds = (near, -SIDEWAYS, height, -math.pi), (far, SIDEWAYS, height, math.pi)
    world.objects["cube"].set_root_pose(common.standing(world.random.uniform((4,), *bounds, env_ids)), env_ids)


def sample_goal(world: World, task: MobileLift, env_ids: Tensor) -> None:
    """Sample the goal over the same stretch of the table, wherever the cube is, from 15 cm above it."""
    near, far = task.patch
    highest = common.workspace(world)[1][2]
    bounds = (near, -SIDEWAYS, task.surface + 0.15), (far, SIDEWAYS, highest)
    task.goal[env_ids] = goal = world.random.uniform((3,), *bounds, env_ids)
    common.place_markers(world, ("goal",), goal[:, None], env_ids)


def beside(task: MobileLift, position: Tensor) -> Tensor:
    """(N, 3) the base at the table, before a position (N, 3) over it, or as near as the table's legs allow."""
    y = position[:, 1].clamp(-0.5 * WIDTH + LEGS, 0.5 * WIDTH - LEGS)
    return torch.stack((torch.full_like(y, EDGE - task.standoff), y, torch.zeros_like(y)), 1)


@dataclass
class MobileLiftState(LiftState):
    """As the state of Lift, and where the base is."""

    base_pose: ObservationTerm | None = ObservationTerm(base_pose)


@dataclass
class MobileLiftObservations(LiftObservations):
    """Policy and critic see the state."""

    policy: LiftState = field(default_factory=MobileLiftState)


@dataclass
class MobileLiftRewards(LiftRewards):
    """As those of Lift, and one that grows over the metres that the base drives."""

    approach: RewardTerm | None = RewardTerm(near_to(cube_pose, 1.0), 1.0)


@dataclass
class MobileLiftTerminations(LiftTerminations):
    """An episode ends early where the cube is dropped or the base falls over."""

    tipped: TerminationTerm | None = TerminationTerm(tipped)


@dataclass
class MobileLiftEvents(LiftEvents):
    """As those of Lift; the base starts anywhere around the table, facing anywhere."""

    place_robot: EventTerm | None = EventTerm(start_in_ring(TABLE, RING))
    place_cube: EventTerm | None = EventTerm(place_cube)
    sample_goal: EventTerm | None = EventTerm(sample_goal)


@dataclass(kw_only=True)
class MobileLift(Mobile, Lift):
    """As Lift, from anywhere around the table; the goal may be farther along the table than the arm reaches.

    The table is as high as suits the robot's arm.
    """

    observation_presets: ClassVar[Mapping[str, Callable[[], Any]]] = {}
    episode_length: float = 24.0
    view: Pose = look_at(eye=(-1.6, 2.6, 2.3), target=(1.2, 0.0, 0.3))
    observations: LiftObservations | LiftPixelObservations = field(default_factory=MobileLiftObservations)
    rewards: LiftRewards = field(default_factory=MobileLiftRewards)
    terminations: LiftTerminations = field(default_factory=MobileLiftTerminations)
    events: LiftEvents = field(default_factory=MobileLiftEvents)
    standoff: float = field(init=False)
    """Metres from the table's side to the middle of a base that stands at it."""
    patch: tuple[float, float] = field(init=False)
    """Lowest and highest x of cube and goal, m."""

    def scene(self) -> Scene:
        robot = mobile(self.robot)
        self._fit(robot)
        board = table("table", (DEPTH, WIDTH, self.surface), pose=Pose((*TABLE, self.surface)))
        return Scene(
            robots=(robot,),
            objects=(self.cube_at((EDGE + 0.1, 0.0, self.surface)), board),
            terrain=(common.floor(),),
            markers=(GOAL,),
            physics_dt=self.physics_dt,
            firm_friction=bool(robot.feet),
        )

    def _fit(self, robot: RobotSpec) -> None:
        """Find the table's height and the places at it that suit the arm."""
        box = common.placed_workspace(robot)
        self.surface = box.low[2] - 0.1
        self.standoff = box.low[0] + 0.05
        self.patch = (EDGE + 0.05, EDGE + box.high[0] - self.standoff)

    def planner(self, robot: RobotSpec) -> BasePlannerConfig:
        """What the expert's paths keep off: the table, or its legs where a walking robot's head fits under it."""
        reach = RING[1] + 1.0
        low, high = (TABLE[0] - reach, TABLE[1] - reach), (TABLE[0] + reach, TABLE[1] + reach)
        height = self.surface - (0.1 if robot.feet else 0.0)
        return BasePlannerConfig(radius=base_radius(robot), height=height, low=low, high=high)

    def expert(self, world: World) -> Expert:
        def to_cube(world: World, task: MobileLift) -> Tensor:
            return beside(task, cube_pose(world, task))

        def to_goal(world: World, task: MobileLift) -> Tensor:
            return beside(task, task.goal)

        phases = (
            Phase(base=to_cube, position_tolerance=0.03, rotation_tolerance=0.05, timeout=14.0),
            *picking.pick(world, at_cube, free=True),
            Phase(picking.straight_up(self.surface + 0.2), False, position_tolerance=0.03, timeout=2.0),
            Phase(None, False, 0.03, 0.05, base=to_goal, timeout=6.0),
            Phase(at_goal, gripper_open=False, free=True),
        )
        spec = common.robot_of(world).spec
        return Expert(world, self, phases, planner=self.planner(spec), sag_rate=sag_rate(world))
