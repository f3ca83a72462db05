"""Soft-Placing: put a soft block on a pad, turned as the pad is."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace

import torch
from torch import Tensor
from torch.linalg import vector_norm

from orbit_assets.objects import SolidOptions, box
from orbit_core.envs import Environment, EventTerm, ObservationGroup, ObservationTerm, RewardTerm
from orbit_core.envs.task import TaskMetadata
from orbit_core.envs.terms import POSE, once_per_state
from orbit_core.mdp import common
from orbit_core.scene import Pose, Scene, look_at
from orbit_motion.experts import Expert
from orbit_tasks import soft
from orbit_tasks.cloth import Smoothness
from orbit_tasks.mdp import matter, picking
from orbit_tasks.soft import BLOCK, lifted, middle, reaching, squeeze

PAD = "pad"
# Metres of the pad.
EXTENT = (0.08, 0.08, 0.02)
# Metres in x and y by which block and pad start off their places, which are 0.24 m apart.
SPREAD = (0.06, 0.06)


@once_per_state
def pad(env: Environment[SoftPlacing]) -> Tensor:
    """(N, 7) the pad's pose, in the environment's frame."""
    return env.world.objects[PAD].root_pose


@once_per_state
def place(env: Environment[SoftPlacing]) -> Tensor:
    """(N, 7) where the block belongs, and the hand that points down along the pad's sides."""
    up = torch.tensor([0.0, 0.0, 0.5 * (EXTENT[2] + env.task.size)], device=env.device)
    return picking.over_square(pad(env)[:, :3] + up, pad(env)[:, 3:])


@once_per_state
def distance(env: Environment[SoftPlacing]) -> Tensor:
    """(N,) metres between the block's middle and its place."""
    return vector_norm(place(env)[:, :3] - middle(env), dim=1)


@once_per_state
def turn(env: Environment[SoftPlacing]) -> Tensor:
    """(N,) rad, at most an eighth of a turn, between the sides of block and pad."""
    return picking.quarter(soft.yaw(env) - picking.quarter_yaw(pad(env)[:, 3:])).abs()


@once_per_state
def placed(env: Environment[SoftPlacing]) -> Tensor:
    """(N,) bool: the block is on the pad, turned as it is, and the hand away from it."""
    return (distance(env) < env.task.tolerance) & (turn(env) < env.task.turn_tolerance) & soft.let_go(env)


def tracking(env: Environment[SoftPlacing], scale: float) -> Tensor:
    """(N,) in [0, 1]: how near a lifted block is to its place."""
    # Counts once it is lifted: a block that is pushed against the pad is near its place as well.
    return lifted(env) * common.nearness(distance(env), scale)


def place_pad(env: Environment[SoftPlacing], env_ids: Tensor) -> None:
    """Place the pad on a patch of the table, turned by any angle."""
    thing = env.world.objects[PAD]
    x, y, z = thing.spec.pose.position
    low, high = (x - SPREAD[0], y - SPREAD[1], z, -math.pi), (x + SPREAD[0], y + SPREAD[1], z, math.pi)
    thing.set_root_pose(common.standing(env.world.random.uniform((4,), low, high, env_ids)), env_ids)


@dataclass
class SoftPlacingState(soft.SoftState):
    """The arm's joints and hand, the block's key points, the last action and the pad."""

    pad: ObservationTerm | None = ObservationTerm(pad, unit=POSE)


@dataclass
class SoftPlacingObservations:
    """State that ``policy`` sees, and ``critic`` as well unless it is given another group."""

    policy: SoftPlacingState = field(default_factory=SoftPlacingState)
    critic: ObservationGroup | None = None


@dataclass
class SoftPlacingRewards(Smoothness):
    """Rewards of the hand at the block, the block off the table, at its place and let go, less what is abrupt."""

    reach: RewardTerm | None = RewardTerm(reaching, 1.0)
    lift: RewardTerm | None = RewardTerm(lifted, 5.0)
    track: RewardTerm | None = RewardTerm(lambda env: tracking(env, 0.3), 8.0)
    """Nearness of the lifted block to its place, within some 0.3 m."""
    track_finely: RewardTerm | None = RewardTerm(lambda env: tracking(env, 0.05), 5.0)
    """The same within 0.05 m, which decides the last centimetres."""
    place: RewardTerm | None = RewardTerm(lambda env: placed(env).float(), 16.0)
    """1 in each step in which the block is on the pad and the hand away from it."""


@dataclass
class SoftPlacingEvents:
    """Robot, block and pad are placed for each episode."""

    place_robot: EventTerm | None = EventTerm(common.randomize_robot_start(0.05))
    place_block: EventTerm | None = EventTerm(matter.place_deformable(BLOCK, SPREAD))
    place_pad: EventTerm | None = EventTerm(place_pad)


@dataclass(kw_only=True)
class SoftPlacing(soft.SoftTask):
    """A soft block stands on the table next to a square pad, each anywhere on a patch of it and turned by any angle.

    Succeeds when at the episode's end the block is on the pad, within ``tolerance`` and ``turn_tolerance``, and the
    hand has let go. Metrics: distance and angle to that pose, and how far the block is squeezed.
    """

    metadata: TaskMetadata = replace(
        soft.SoftTask.metadata, view=look_at(eye=(1.2, 0.8, 0.6), target=(0.45, 0.0, 0.05))
    )
    episode_length: float = 6.0
    tolerance: float = 0.02
    """Metres."""
    turn_tolerance: float = 0.2
    """Radians."""
    observations: SoftPlacingObservations = field(default_factory=SoftPlacingObservations)
    rewards: SoftPlacingRewards = field(default_factory=SoftPlacingRewards)
    terminations: soft.SoftTerminations = field(default_factory=soft.SoftTerminations)
    events: SoftPlacingEvents = field(default_factory=SoftPlacingEvents)

    def scene(self) -> Scene:
        where = Pose((0.48, 0.12, 0.5 * EXTENT[2]))
        # Fixed, or a block that is put down aslant would push the pad away.
        options = SolidOptions(mass=1.0, fixed_base=True, pose=where, color=(0.35, 0.5, 0.7, 1.0))
        return self.on_bench((self.block((0.48, -0.12, 0.5 * self.size)),), box(PAD, EXTENT, **options))

    def success(self, env: Environment) -> Tensor:
        return placed(env)

    def metrics(self, env: Environment) -> dict[str, Tensor]:
        return {"place_distance_m": distance(env), "place_turn_rad": turn(env), "squeeze": squeeze(env)}

    def expert(self, env: Environment) -> Expert:
        return Expert(env, soft.moving(env.world, place))
