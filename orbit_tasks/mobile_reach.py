"""Mobile-Reach: drive to where the arm reaches a sampled pose, and bring the end effector there."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import Any, ClassVar

import torch
from torch import Tensor

from orbit_core.dynamics.transforms import quat_from_euler, quat_multiply
from orbit_core.envs import CommandTerm, Environment, EventTerm, ObservationTerm, RewardTerm, TerminationTerm
from orbit_core.envs.task import TaskMetadata
from orbit_core.envs.terms import Bounds
from orbit_core.mdp import common
from orbit_core.mdp.commands import UniformPoseCommand
from orbit_core.scene import MarkerShape, MarkerSpec, Scene, look_at
from orbit_motion.experts import Expert, Phase
from orbit_tasks.mobile import (
    Mobile,
    ahead_of,
    base_pose,
    mobile,
    near_to,
    over_floor,
    reach_ahead,
    sag_rate,
    start_within,
    tipped,
)
from orbit_tasks.reach import (
    Reach,
    ReachCommands,
    ReachEvents,
    ReachObservations,
    ReachPixelObservations,
    ReachRewards,
    ReachState,
    ReachTerminations,
)

# Metres over the floor from where the base starts to the goal; an arm reaches less than one.
NEAREST, FARTHEST = 1.5, 2.5


@dataclass(unsafe_hash=True, kw_only=True)
class MobileReachGoal(UniformPoseCommand):
    """Pose in a ring around the base, at the heights of the hand's workspace, turned by any angle.

    ``x`` is the distance from the base in m, ``y`` the bearing in rad.
    """

    live: ClassVar[frozenset[str]] = frozenset()

    def reach(self, env: Environment) -> dict[str, Bounds]:
        around = (-math.pi, math.pi)
        return {**super().reach(env), "x": (NEAREST, FARTHEST), "y": around, "yaw": around}

    def command(self, env: Environment, drawn: Tensor, env_ids: Tensor) -> Tensor:
        distance, bearing, height, roll, pitch, yaw = drawn.unbind(1)
        start = over_floor(base_pose(env)[env_ids])
        place = start[:, :2] + torch.stack((distance * bearing.cos(), distance * bearing.sin()), 1)
        # Tilt before yaw, so that it is relative to a hand that points down, however it is turned.
        tilt = quat_from_euler(roll, pitch, torch.zeros_like(yaw))
        orientation = quat_multiply(common.turned(yaw), quat_multiply(tilt, common.facing_down(torch.zeros_like(yaw))))
        return torch.cat((place, height[:, None], orientation), dim=1)


def before_goal(env: Environment[MobileReach]) -> Tensor:
    """(N, 3) the base where the goal is ahead, in the middle of the workspace."""
    return ahead_of(over_floor(env.commands["goal"]), reach_ahead(env.world))


@dataclass
class MobileReachState(ReachState):
    """State of Reach, and the base's pose."""

    base_pose: ObservationTerm | None = ObservationTerm(base_pose)


@dataclass
class MobileReachObservations(ReachObservations):
    """State that ``policy`` sees, and ``critic`` as well unless it is given another group."""

    policy: ReachState = field(default_factory=MobileReachState)


@dataclass
class MobileReachRewards(ReachRewards):
    """Rewards of Reach with a distance term scaled for a moving base."""

    position: RewardTerm | None = RewardTerm(near_to(lambda env: env.commands["goal"], 1.0), 2.0)


@dataclass
class MobileReachTerminations(ReachTerminations):
    """An episode ends early where the base falls over."""

    tipped: TerminationTerm | None = TerminationTerm(tipped)


@dataclass
class MobileReachCommands(ReachCommands):
    """The goal: a pose around the base."""

    goal: CommandTerm | None = MobileReachGoal(marker="goal")


@dataclass
class MobileReachEvents(ReachEvents):
    """Events of Reach; the base starts about the middle, facing anywhere."""

    place_robot: EventTerm | None = EventTerm(start_within((-0.5, -0.5), (0.5, 0.5), spread=0.2))


@dataclass(kw_only=True)
class MobileReach(Mobile, Reach):
    """Variant of Reach with the goal 1.5 to 2.5 m from the base's start, in any direction and turned by any angle."""

    observation_presets: ClassVar[Mapping[str, Callable[[], Any]]] = {}
    episode_length: float = 12.0
    metadata: TaskMetadata = replace(
        Reach.metadata,
        view=look_at(eye=(3.2, 2.6, 2.4), target=(0.0, 0.0, 0.3)),
    )
    observations: ReachObservations | ReachPixelObservations = field(default_factory=MobileReachObservations)
    rewards: ReachRewards = field(default_factory=MobileReachRewards)
    terminations: ReachTerminations = field(default_factory=MobileReachTerminations)
    events: ReachEvents = field(default_factory=MobileReachEvents)
    commands: ReachCommands = field(default_factory=MobileReachCommands)

    def scene(self) -> Scene:
        robot = mobile(self.robot, gripper=False)
        scene = Scene(
            robots=(robot,),
            terrain=(common.floor(),),
            markers=(MarkerSpec("goal", MarkerShape.FRAME, size=0.15),),
            physics_dt=self.physics_dt,
            firm_friction=bool(robot.feet),
        )
        return self.in_surroundings(scene)

    def expert(self, env: Environment) -> Expert:
        return Expert(
            env,
            (
                # Loose: the arm makes up for what the base is off.
                Phase(base=before_goal, position_tolerance=0.08, rotation_tolerance=0.15),
                Phase(lambda env: env.commands["goal"], free=True),
            ),
            sag_rate=sag_rate(env.world),
        )
