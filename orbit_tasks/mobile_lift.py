"""Mobile-Lift: drive around a table to a cube, grasp it, and hold it at a sampled position."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import Any, ClassVar

import torch
from torch import Tensor

from orbit_assets.objects import table
from orbit_core.envs import CommandTerm, Environment, EventTerm, ObservationTerm, RewardTerm, TerminationTerm
from orbit_core.envs.state import TaskState
from orbit_core.envs.task import TaskMetadata
from orbit_core.envs.terms import Bounds
from orbit_core.mdp import common
from orbit_core.mdp.commands import UniformPositionCommand
from orbit_core.scene import Pose, RobotSpec, Scene, look_at
from orbit_motion.experts import Expert, Phase
from orbit_motion.planning import BasePlannerConfig
from orbit_tasks.lift import (
    GOAL,
    Lift,
    LiftCommands,
    LiftEvents,
    LiftMemory,
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

# Metres of the table along x and y.
DEPTH, WIDTH = 0.6, 1.4
# Where its middle is.
TABLE = (1.5, 0.0)
# x in m of the side at which the cube is.
EDGE = TABLE[0] - 0.5 * DEPTH
# Metres from the middle of the table to where the base starts.
RING = (1.5, 2.3)
# Metres from the middle of the side within which cube and goal are; and what a base keeps off its ends.
SIDEWAYS, LEGS = 0.45, 0.4


class MobileLiftMemory(LiftMemory):
    """State of a lift at a table, looked up once in a new world."""

    standoff: float
    """Metres from the table's side to the middle of a base that stands at it."""
    patch: tuple[float, float]
    """Lowest and highest x of cube and goal, m."""

    def start(self, env: Environment[MobileLift]) -> None:
        super().start(env)
        self.surface, self.standoff, self.patch = _fit(common.robot_of(env.world).spec)


def _fit(robot: RobotSpec) -> tuple[float, float, tuple[float, float]]:
    """Find the table's height, how far off a base stands, and lowest and highest x at it, that suit the arm, m."""
    box = common.placed_workspace(robot)
    standoff = box.low[0] + 0.05
    return box.low[2] - 0.1, standoff, (EDGE + 0.05, EDGE + box.high[0] - standoff)


def place_cube(env: Environment[MobileLift, MobileLiftMemory], env_ids: Tensor) -> None:
    """Place the cube along the side of the table, turned by any angle."""
    (near, far), height = env.state.patch, env.state.surface + env.state.rest_height
    bounds = (near, -SIDEWAYS, height, -math.pi), (far, SIDEWAYS, height, math.pi)
    env.world.objects["cube"].set_root_pose(common.standing(env.world.random.uniform((4,), *bounds, env_ids)), env_ids)


@dataclass(unsafe_hash=True, kw_only=True)
class MobileLiftGoal(UniformPositionCommand):
    """Position over the same stretch of the table, independent of the cube, from 15 cm above it."""

    def reach(self, env: Environment[MobileLift, MobileLiftMemory]) -> dict[str, Bounds]:
        low = env.state.surface + 0.15
        return {"x": env.state.patch, "y": (-SIDEWAYS, SIDEWAYS), "z": (low, common.workspace(env.world)[1][2])}


def beside(env: Environment[MobileLift, MobileLiftMemory], position: Tensor) -> Tensor:
    """(N, 3) the base at the table, before a position (N, 3) over it, or as near as the table's legs allow."""
    y = position[:, 1].clamp(-0.5 * WIDTH + LEGS, 0.5 * WIDTH - LEGS)
    return torch.stack((torch.full_like(y, EDGE - env.state.standoff), y, torch.zeros_like(y)), 1)


@dataclass
class MobileLiftState(LiftState):
    """State of Lift, and the base's pose."""

    base_pose: ObservationTerm | None = ObservationTerm(base_pose)


@dataclass
class MobileLiftObservations(LiftObservations):
    """State that ``policy`` sees, and ``critic`` as well unless it is given another group."""

    policy: LiftState = field(default_factory=MobileLiftState)


@dataclass
class MobileLiftRewards(LiftRewards):
    """Rewards of Lift, and one that grows over the metres that the base drives."""

    approach: RewardTerm | None = RewardTerm(near_to(cube_pose, 1.0), 1.0)


@dataclass
class MobileLiftTerminations(LiftTerminations):
    """An episode ends early where the cube is dropped or the base falls over."""

    tipped: TerminationTerm | None = TerminationTerm(tipped)


@dataclass
class MobileLiftCommands(LiftCommands):
    """The position that the cube is to be brought to."""

    goal: CommandTerm | None = MobileLiftGoal(marker="goal")


@dataclass
class MobileLiftEvents(LiftEvents):
    """Events of Lift; the base starts anywhere around the table, facing anywhere."""

    place_robot: EventTerm | None = EventTerm(start_in_ring(TABLE, RING))
    place_cube: EventTerm | None = EventTerm(place_cube)


@dataclass(kw_only=True)
class MobileLift(Mobile, Lift):
    """Variant of Lift, from anywhere around the table; the goal may be farther along the table than the arm reaches.

    The table is as high as suits the robot's arm.
    """

    state_type: ClassVar[type[TaskState]] = MobileLiftMemory
    observation_presets: ClassVar[Mapping[str, Callable[[], Any]]] = {}
    episode_length: float = 24.0
    metadata: TaskMetadata = replace(
        Lift.metadata,
        view=look_at(eye=(-1.6, 2.6, 2.3), target=(1.2, 0.0, 0.3)),
    )
    observations: LiftObservations | LiftPixelObservations = field(default_factory=MobileLiftObservations)
    rewards: LiftRewards = field(default_factory=MobileLiftRewards)
    terminations: LiftTerminations = field(default_factory=MobileLiftTerminations)
    events: LiftEvents = field(default_factory=MobileLiftEvents)
    commands: LiftCommands = field(default_factory=MobileLiftCommands)

    def scene(self) -> Scene:
        robot = mobile(self.robot)
        surface, *_ = _fit(robot)
        board = table("table", (DEPTH, WIDTH, surface), pose=Pose((*TABLE, surface)))
        scene = Scene(
            robots=(robot,),
            objects=(self.cube_at((EDGE + 0.1, 0.0, surface)), board),
            terrain=(common.floor(),),
            markers=(GOAL,),
            physics_dt=self.physics_dt,
            firm_friction=bool(robot.feet),
        )
        return self.in_surroundings(scene)

    def planner(self, robot: RobotSpec, surface: float) -> BasePlannerConfig:
        """Return the planner of paths; they avoid the table, or its legs if a walking robot fits under it."""
        reach = RING[1] + 1.0
        low, high = (TABLE[0] - reach, TABLE[1] - reach), (TABLE[0] + reach, TABLE[1] + reach)
        height = surface - (0.1 if robot.feet else 0.0)
        return BasePlannerConfig(radius=base_radius(robot), height=height, low=low, high=high)

    def expert(self, env: Environment[Any, MobileLiftMemory]) -> Expert:
        def to_cube(env: Environment[MobileLift]) -> Tensor:
            return beside(env, cube_pose(env))

        def to_goal(env: Environment[MobileLift]) -> Tensor:
            return beside(env, env.commands["goal"])

        phases = (
            Phase(base=to_cube, position_tolerance=0.03, rotation_tolerance=0.05, timeout=14.0),
            *picking.pick(env.world, at_cube, free=True),
            Phase(picking.straight_up(env.state.surface + 0.2), False, position_tolerance=0.03, timeout=2.0),
            Phase(None, False, 0.03, 0.05, base=to_goal, timeout=6.0),
            Phase(at_goal, gripper_open=False, free=True),
        )
        spec = common.robot_of(env.world).spec
        return Expert(env, phases, planner=self.planner(spec, env.state.surface), sag_rate=sag_rate(env.world))
