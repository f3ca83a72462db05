"""Soft-Dropping: drop a soft block into a container."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import torch
from torch import Tensor
from torch.linalg import vector_norm

from orbit_assets.deformables import open_box
from orbit_core.envs import Environment, EventTerm, ObservationGroup, ObservationTerm, RewardTerm
from orbit_core.envs.task import TaskMetadata
from orbit_core.envs.terms import measured_in, once_per_state
from orbit_core.mdp import common
from orbit_core.scene import Pose, Region, Scene, look_at
from orbit_motion.experts import Expert, Phase
from orbit_tasks import soft
from orbit_tasks.cloth import Smoothness
from orbit_tasks.mdp import matter, picking
from orbit_tasks.soft import BLOCK, lifted, middle, reaching, squeeze

CONTAINER = "container"
# Metres within the container.
INNER = (0.16, 0.16, 0.08)
# Metres in x and y by which block and container start off their places, which are 0.27 m apart.
SPREAD = (0.06, 0.06)
# Metres above the container's floor at which the block is let go, clear of its walls.
HEIGHT = 0.15


@measured_in("m")
@once_per_state
def container(env: Environment[SoftDropping]) -> Tensor:
    """(N, 3) the middle of the container's floor."""
    return env.world.objects[CONTAINER].root_pose[:, :3]


@once_per_state
def distance(env: Environment[SoftDropping]) -> Tensor:
    """(N,) metres between the block's middle and that of the container, less what it is above the floor in it."""
    away = middle(env) - container(env)
    above = (away[:, 2] - INNER[2]).clamp_min(0.0)
    return torch.sqrt(away[:, 0] ** 2 + away[:, 1] ** 2 + above**2)


@once_per_state
def inside(env: Environment[SoftDropping]) -> Tensor:
    """(N,) in [0, 1]: the part of the block that is in the container."""
    # A block may lean on a wall and press a little into it.
    half = tuple(0.5 * extent + 0.005 for extent in INNER)
    region = Region((half[0], half[1], half[2]), Pose((0.0, 0.0, 0.5 * INNER[2])), CONTAINER, CONTAINER)
    return env.world.deformables[BLOCK].share_inside(region)


def above(env: Environment[SoftDropping]) -> Tensor:
    """(N, 7) the hand that has the block over the container's middle, as it hangs in the hand now."""
    goal = container(env) + torch.tensor([0.0, 0.0, HEIGHT], device=env.device)
    return common.pointing_down(goal + common.hand_pose(env)[:, :3] - middle(env))


def tracking(env: Environment[SoftDropping]) -> Tensor:
    """(N,) in [0, 1]: how near a lifted block is to the container's middle."""
    # In x and y only: the block is carried above the rim before it is dropped.
    return lifted(env) * common.nearness(vector_norm((middle(env) - container(env))[:, :2], dim=1), 0.3)


def place_container(env: Environment[SoftDropping], env_ids: Tensor) -> None:
    """Place the container on a patch of the table."""
    thing = env.world.objects[CONTAINER]
    x, y, z = thing.spec.pose.position
    shift = env.world.random.uniform((2,), (-SPREAD[0], -SPREAD[1]), SPREAD, env_ids)
    pose = torch.tensor([x, y, z, 1.0, 0.0, 0.0, 0.0], device=env.device).repeat(len(env_ids), 1)
    pose[:, :2] += shift
    thing.set_root_pose(pose, env_ids)


@dataclass
class SoftDroppingState(soft.SoftState):
    """The arm's joints and hand, the block's key points, the last action and the container."""

    container: ObservationTerm | None = ObservationTerm(container)


@dataclass
class SoftDroppingObservations:
    """State that ``policy`` sees, and ``critic`` as well unless it is given another group."""

    policy: SoftDroppingState = field(default_factory=SoftDroppingState)
    critic: ObservationGroup | None = None


@dataclass
class SoftDroppingRewards(Smoothness):
    """Rewards of the hand at the block, the block over the container and in it, less what is fast or abrupt."""

    reach: RewardTerm | None = RewardTerm(reaching, 1.0)
    lift: RewardTerm | None = RewardTerm(lifted, 5.0)
    track: RewardTerm | None = RewardTerm(tracking, 8.0)
    drop: RewardTerm | None = RewardTerm(inside, 32.0)


@dataclass
class SoftDroppingEvents:
    """Robot, block and container are placed for each episode."""

    place_robot: EventTerm | None = EventTerm(common.randomize_robot_start(0.05))
    place_block: EventTerm | None = EventTerm(matter.place_deformable(BLOCK, SPREAD))
    place_container: EventTerm | None = EventTerm(place_container)


@dataclass(kw_only=True)
class SoftDropping(soft.SoftTask):
    """A soft block stands on the table, anywhere on a patch of it and turned by any angle, next to a container.

    Succeeds when at the episode's end at least ``least_inside`` of the block is in the container and the hand has let
    go. Metrics: its distance to the container's middle, that part, and how far the block is squeezed.
    """

    metadata: TaskMetadata = replace(
        soft.SoftTask.metadata, view=look_at(eye=(1.2, 0.8, 0.7), target=(0.45, 0.0, 0.05))
    )
    episode_length: float = 7.0
    least_inside: float = 0.99
    observations: SoftDroppingObservations = field(default_factory=SoftDroppingObservations)
    rewards: SoftDroppingRewards = field(default_factory=SoftDroppingRewards)
    terminations: soft.SoftTerminations = field(default_factory=soft.SoftTerminations)
    events: SoftDroppingEvents = field(default_factory=SoftDroppingEvents)

    def scene(self) -> Scene:
        return self.on_bench(
            (self.block((0.48, -0.13, 0.5 * self.size)),), open_box(CONTAINER, INNER, Pose((0.48, 0.14, 0.01)))
        )

    def success(self, env: Environment) -> Tensor:
        return (inside(env) >= self.least_inside) & soft.let_go(env)

    def metrics(self, env: Environment) -> dict[str, Tensor]:
        return {"container_distance_m": distance(env), "inside": inside(env), "squeeze": squeeze(env)}

    def expert(self, env: Environment) -> Expert:
        phases = (
            *soft.taking(env.world),
            Phase(picking.straight_up(soft.CARRIED), False, position_tolerance=0.03, timeout=2.0),
            Phase(above, False, position_tolerance=0.01, rotation_tolerance=0.2, timeout=3.0),
            Phase(above, dwell=0.3, timeout=0.4),
            Phase(picking.straight_up(soft.CARRIED)),
        )
        return Expert(env, phases)
