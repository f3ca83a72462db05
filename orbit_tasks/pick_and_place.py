"""Pick-And-Place: take a cube from one half of the table and put it down on a mark on the other."""

# Groups of terms are extended by deriving from them.
# pyright: reportIncompatibleVariableOverride=false

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any, ClassVar

import torch
from torch import Tensor
from torch.linalg import vector_norm

from orbit_assets.object_kinds import BoxConfig
from orbit_core.envs import CommandTerm, Environment, EventTerm, ObservationTerm, RewardTerm
from orbit_core.envs.ppo import PpoSettings
from orbit_core.envs.state import TaskState
from orbit_core.envs.task import Subtask, TaskMetadata
from orbit_core.envs.terms import ENVIRONMENT, Bounds, means, measured_in, once_per_state
from orbit_core.mdp import common
from orbit_core.objects import ObjectConfig
from orbit_motion.experts import Expert, Phase
from orbit_tasks import lift
from orbit_tasks.lift import Lift, LiftEvents, LiftGoal, LiftMemory, LiftPixelObservations, LiftState, narrowed

# Metres from the line between the halves of the table to the nearest start and to the nearest mark.
_APART = 0.04
# Metres by which the hand is raised over the cube's place on its way.
_CARRIED = 0.06
# Metres from a cube of which the hand has let go.
_AWAY = 0.04


class PickAndPlaceMemory(LiftMemory):
    """State of a cube on its way, looked up once in a new world."""

    opening: common.GripperOpening
    """Reader of the share by which the gripper is open."""

    def start(self, env: Environment) -> None:
        super().start(env)
        self.opening = common.GripperOpening(env.world)


@means("position of the mark's cube minus that of the cube's origin", ENVIRONMENT)
@measured_in("m")
@once_per_state
def cube_to_goal(env: Environment[PickAndPlace]) -> Tensor:
    """(N, 3) from the cube to where it belongs."""
    return env.commands["goal"] - lift.cube_position(env)


@once_per_state
def placed(env: Environment[PickAndPlace]) -> Tensor:
    """(N,) bool: the cube stands on its mark, whoever holds it."""
    return lift.goal_distance(env) < env.task.tolerance


@once_per_state
def let_go(env: Environment[PickAndPlace]) -> Tensor:
    """(N,) bool: the cube stands on its mark and the hand is away from it."""
    return placed(env) & (vector_norm(lift.hand_to_cube(env), dim=1) > _AWAY)


def tracking(env: Environment[PickAndPlace], scale: float) -> Tensor:
    """(N,) in [0, 1]: how near the mark a cube is that was lifted, or that is there."""
    # Not on the way along the table: a cube that is pushed comes nearer as well.
    moved = torch.maximum(lift.lifted(env), placed(env).float())
    return moved * common.nearness(lift.goal_distance(env), scale)


def letting_go(env: Environment[PickAndPlace, PickAndPlaceMemory]) -> Tensor:
    """(N,) in [0, 1]: how far the gripper is open, and the hand has left, where the cube is on its mark."""
    away = (vector_norm(lift.hand_to_cube(env), dim=1) / _AWAY).clamp(max=1.0)
    return 0.5 * (env.state.opening() + away) * placed(env)


def place_cube(env: Environment[PickAndPlace, PickAndPlaceMemory], env_ids: Tensor) -> None:
    """Place the cube on the right half of the hand's workspace, turned by any angle."""
    (low, high), spread = lift.patch(env.world), env.task.start_spread
    near, far = narrowed((low[0], high[0]), spread)
    right, left = narrowed((low[1], 0.5 * (low[1] + high[1]) - _APART), spread)
    height, turn = env.state.rest_height, math.pi * spread
    place = env.world.random.uniform((4,), (near, right, height, -turn), (far, left, height, turn), env_ids)
    env.world.objects["cube"].set_root_pose(common.standing(place), env_ids)


@dataclass(unsafe_hash=True, kw_only=True)
class Mark(LiftGoal):
    """Position of the cube's middle as it stands on the left half of the hand's workspace."""

    def reach(self, env: Environment) -> dict[str, Bounds]:
        low, high = lift.patch(env.world)
        x, y = (low[0], high[0]), (0.5 * (low[1] + high[1]) + _APART, high[1])
        height = env.state.rest_height
        return {"x": narrowed(x, self.spread), "y": narrowed(y, self.spread), "z": (height, height)}


def _raised(env: Environment, position: Tensor) -> Tensor:
    """Return the hand (N, 7), pointing down as its arm can, above positions (N, 3) of a cube on the table."""
    up = torch.tensor([0.0, 0.0, _CARRIED], device=env.device)
    return common.leaning(env, common.pointing_down(position + up))


def _up(env: Environment[PickAndPlace, PickAndPlaceMemory]) -> Tensor:
    """(N, 7) the hand above where it is now."""
    here = common.hand_position(env)
    return _raised(env, torch.cat((here[:, :2], torch.full_like(here[:, :1], env.state.rest_height)), dim=1))


def _over_mark(env: Environment[PickAndPlace]) -> Tensor:
    """(N, 7) the hand above the mark."""
    return _raised(env, env.commands["goal"])


@dataclass
class PickAndPlaceState(LiftState):
    """Observations of Lift's policy, and the way from the cube to its mark."""

    cube_to_goal: ObservationTerm | None = ObservationTerm(cube_to_goal)


@dataclass
class PickAndPlaceObservations:
    """State that ``policy`` sees."""

    policy: PickAndPlaceState = field(default_factory=PickAndPlaceState)


@dataclass
class PickAndPlaceRewards:
    """Rewards of the hand at the cube, the cube off the table, near its mark and let go, less what is abrupt.

    A cube that is held on its mark for ever earns less than one that is let go.
    """

    reach: RewardTerm | None = RewardTerm(lift.reaching, 1.0)
    lift: RewardTerm | None = RewardTerm(lambda env: torch.maximum(lift.lifted(env), placed(env).float()), 5.0)
    """The cube off the table, or on its mark."""
    track: RewardTerm | None = RewardTerm(lambda env: tracking(env, 0.3), 8.0)
    """Nearness of the cube to its mark, within some 0.3 m."""
    track_finely: RewardTerm | None = RewardTerm(lambda env: tracking(env, 0.05), 5.0)
    """The same within 0.05 m."""
    let_go: RewardTerm | None = RewardTerm(letting_go, 20.0)
    action_rate: RewardTerm | None = RewardTerm(common.action_rate, -1e-4)
    joint_speed: RewardTerm | None = RewardTerm(common.joint_speed, -1e-4)


@dataclass
class PickAndPlaceEvents(LiftEvents):
    """Lift's, with the cube on its half of the table."""

    place_cube: EventTerm | None = EventTerm(place_cube)


@dataclass
class PickAndPlaceCommands:
    """The position that the cube is to be put at."""

    goal: CommandTerm | None = Mark()


@dataclass(kw_only=True)
class PickAndPlace(Lift):
    """The cube starts on one half of the table, turned by any angle; its mark is on the other.

    Succeeds when at the episode's end the cube's centre is within ``tolerance`` of where it stands on its mark, and the
    hand is 4 cm away from it. Metric: the distance of the cube to its mark.
    """

    state_type: ClassVar[type[TaskState]] = PickAndPlaceMemory
    renamed: ClassVar[Mapping[str, str]] = {}
    observation_presets: ClassVar[Mapping[str, Callable[[], Any]]] = {"pixels": LiftPixelObservations}
    episode_length: float = 8.0
    metadata: TaskMetadata = TaskMetadata(
        instruction="put the cube on the mark",
        subtasks=(Subtask(lift.at_cube, lift.off_table), Subtask(lift.goal_frame, placed)),
        ppo=PpoSettings(iterations=1500, initial_std=0.3, entropy_weight=0.005),
    )
    # Small enough for the jaws of every gripper of the catalogue, those of SO-101 among them.
    cube: ObjectConfig = BoxConfig(size=(0.03, 0.03, 0.03), mass=0.05, color=(0.8, 0.2, 0.15, 1.0))
    """Object that is moved; :func:`orbit_core.objects.object_kinds` has other kinds."""
    observations: PickAndPlaceObservations | LiftPixelObservations = field(default_factory=PickAndPlaceObservations)
    rewards: PickAndPlaceRewards = field(default_factory=PickAndPlaceRewards)
    events: PickAndPlaceEvents = field(default_factory=PickAndPlaceEvents)
    commands: PickAndPlaceCommands = field(default_factory=PickAndPlaceCommands)

    def success(self, env: Environment) -> Tensor:
        return let_go(env)

    def expert(self, env: Environment) -> Expert:
        closing = max(0.4, common.closing_time(env.world))
        lead = lift.position_lead(env)
        return Expert(
            env,
            (
                Phase(lift.above_cube, position_tolerance=0.02, free=True),
                Phase(lift.at_cube, position_tolerance=0.006, timeout=1.5),
                Phase(lift.at_cube, gripper_open=False, dwell=closing, timeout=closing + 0.1),
                Phase(_up, False, position_tolerance=0.02, rotation_tolerance=math.inf, timeout=1.5),
                Phase(_over_mark, False, position_tolerance=0.015, timeout=2.5, free=True),
                Phase(lift.at_goal, False, position_tolerance=0.004, timeout=1.5),
                # The hand stays where it is: the cube may move a little as the jaws open.
                Phase(common.hand_pose, dwell=closing, timeout=closing + 0.1),
                # Straight up, for a cube at times leans on a jaw, and is dragged along by one that moves aside.
                Phase(_up),
            ),
            position_lead=lead,
            rotation_lead=5.0 * lead,
        )
