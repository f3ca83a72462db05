"""Soft-Stacking: put one soft block on another."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import torch
from torch import Tensor
from torch.linalg import vector_norm

from orbit_core.envs import Environment, EventTerm, ObservationGroup, ObservationTerm, RewardTerm
from orbit_core.envs.task import TaskMetadata
from orbit_core.envs.terms import once_per_state
from orbit_core.mdp import common
from orbit_core.scene import Scene, look_at
from orbit_motion.experts import Expert
from orbit_tasks import soft
from orbit_tasks.cloth import Smoothness
from orbit_tasks.mdp import matter, picking
from orbit_tasks.soft import BLOCK, lifted, middle, reaching, squeeze, tilt

BASE = "base"
# Metres in x and y by which blocks start off their places, which are 0.24 m apart.
SPREAD = (0.06, 0.06)


@once_per_state
def base(env: Environment[SoftStacking]) -> Tensor:
    """(N, 3) the middle of the block that stays, in the environment's frame."""
    return env.world.deformables[BASE].key_point("middle")


@once_per_state
def place(env: Environment[SoftStacking]) -> Tensor:
    """(N, 7) where the block belongs, and the hand that points down along the faces of the one below."""
    below = env.world.deformables[BASE]
    way = below.key_point("front") - base(env)
    up = torch.tensor([0.0, 0.0, env.task.size], device=env.device)
    # A square block looks the same after a quarter turn: the hand takes the least.
    turn = picking.quarter(torch.atan2(way[:, 1], way[:, 0]))
    return torch.cat((base(env) + up, common.facing_down(turn)), dim=1)


@once_per_state
def away(env: Environment[SoftStacking]) -> Tensor:
    """(N, 3) from the block to its place."""
    return place(env)[:, :3] - middle(env)


@once_per_state
def distance(env: Environment[SoftStacking]) -> Tensor:
    """(N,) horizontal metres between the middles of both blocks, and its size more for each rad of tilt."""
    return vector_norm(away(env)[:, :2], dim=1) + env.task.size * tilt(env)


@once_per_state
def stacked(env: Environment[SoftStacking]) -> Tensor:
    """(N,) bool: the block is upright on the other, and the hand away from it."""
    # Soft blocks sag, so that height is judged by a part of the size and not by the tolerance.
    level = away(env)[:, 2].abs() < 0.3 * env.task.size
    return (distance(env) < env.task.tolerance) & level & soft.let_go(env)


def tracking(env: Environment[SoftStacking], scale: float) -> Tensor:
    """(N,) in [0, 1]: how near a lifted block is to its place."""
    # Counts once it is lifted: a block that is pushed against the other is near its place as well.
    return lifted(env) * common.nearness(vector_norm(away(env), dim=1), scale)


@dataclass
class SoftStackingState(soft.SoftState):
    """The arm's joints and hand, the key points of both blocks and the last action."""

    base_points: ObservationTerm | None = ObservationTerm(matter.key_points(BASE))


@dataclass
class SoftStackingObservations:
    """State that ``policy`` sees, and ``critic`` as well unless it is given another group."""

    policy: SoftStackingState = field(default_factory=SoftStackingState)
    critic: ObservationGroup | None = None


@dataclass
class SoftStackingRewards(Smoothness):
    """Rewards of the hand at the block, the block off the table, at its place and let go, less what is abrupt."""

    reach: RewardTerm | None = RewardTerm(reaching, 1.0)
    lift: RewardTerm | None = RewardTerm(lifted, 5.0)
    track: RewardTerm | None = RewardTerm(lambda env: tracking(env, 0.3), 8.0)
    """Nearness of the lifted block to its place, within some 0.3 m."""
    track_finely: RewardTerm | None = RewardTerm(lambda env: tracking(env, 0.05), 5.0)
    """The same within 0.05 m, which decides the last centimetres."""
    stack: RewardTerm | None = RewardTerm(lambda env: stacked(env).float(), 16.0)
    """1 in each step in which the block is on the other and the hand away from it."""


@dataclass
class SoftStackingEvents:
    """Robot and blocks are placed for each episode."""

    place_robot: EventTerm | None = EventTerm(common.randomize_robot_start(0.05))
    place_block: EventTerm | None = EventTerm(matter.place_deformable(BLOCK, SPREAD))
    place_base: EventTerm | None = EventTerm(matter.place_deformable(BASE, SPREAD))


@dataclass(kw_only=True)
class SoftStacking(soft.SoftTask):
    """Two soft blocks stand on the table, each anywhere on a patch of it and turned by any angle.

    Succeeds when at the episode's end one is on the other, within ``tolerance``, and the hand has let go. Metrics: the
    horizontal distance of their middles with a penalty for tilt, and how far the block is squeezed.
    """

    metadata: TaskMetadata = replace(
        soft.SoftTask.metadata, view=look_at(eye=(1.2, 0.8, 0.6), target=(0.45, 0.0, 0.05))
    )
    episode_length: float = 6.0
    tolerance: float = 0.02
    """Metres."""
    observations: SoftStackingObservations = field(default_factory=SoftStackingObservations)
    rewards: SoftStackingRewards = field(default_factory=SoftStackingRewards)
    terminations: soft.SoftTerminations = field(default_factory=soft.SoftTerminations)
    events: SoftStackingEvents = field(default_factory=SoftStackingEvents)

    def scene(self) -> Scene:
        x, z = 0.48, 0.5 * self.size
        return self.on_bench((self.block((x, -0.12, z)), self.block((x, 0.12, z), BASE, (0.9, 0.6, 0.2, 1.0))))

    def success(self, env: Environment) -> Tensor:
        return stacked(env)

    def metrics(self, env: Environment) -> dict[str, Tensor]:
        return {"stack_distance_m": distance(env), "squeeze": squeeze(env)}

    def expert(self, env: Environment) -> Expert:
        return Expert(env, soft.moving(env.world, place))
