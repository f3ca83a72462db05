"""Cloth-Folding: take a corner that hangs over a tray's edge and fold the cloth along its diagonal."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace

import torch
from torch import Tensor
from torch.linalg import vector_norm

from orbit_core.dynamics.transforms import quat_from_rotation_vector, quat_multiply
from orbit_core.envs import EventTerm, Expert, ObservationGroup, Phase, RewardTerm
from orbit_core.envs.terms import TermFunction, once_per_state
from orbit_core.interfaces import World
from orbit_core.mdp import common, matter
from orbit_core.scene import KeyPoint, PhysicsMaterial, Pose, Scene, look_at
from orbit_tasks import cloth
from orbit_tasks.cloth import CLOTH

STAND = 0.06
"""Height in metres of the tray, over whose edge a corner hangs."""
HANGING = 0.05
"""Metres of the cloth's diagonal that are beyond the tray's edge."""
PAIRS = (("corner--", "corner++"), ("side-", "back"), ("front", "side+"))
"""Key points that the fold along the other diagonal lays on each other; the first is taken."""
ROUGH = PhysicsMaterial(static_friction=0.6, dynamic_friction=0.6)
"""Of the tray, which keeps the cloth in place while its corner is carried over."""
ROWS = 2
"""Of particles from the corner's tip to where the hand takes it, along both sides."""
TAKES, LEAVES = math.radians(20.0), math.radians(-45.0)
"""By how much the hand leans away from the fold where it takes the corner, and where it lets go on the other side."""

grip = cloth.key_point("grip")
"""(N, 3) where the hand takes the cloth, in the environment's frame."""


@once_per_state
def pair_distances(world: World, task: ClothFolding) -> Tensor:
    """(N, 3) metres between the key points of each pair."""
    thing = world.deformables[CLOTH]
    apart = [thing.key_point(one) - thing.key_point(other) for one, other in PAIRS]
    return vector_norm(torch.stack(apart, dim=1), dim=2)


@once_per_state
def distance(world: World, task: ClothFolding) -> Tensor:
    """(N,) metres: the sum over pairs."""
    return pair_distances(world, task).sum(1)


def remember_fold(world: World, task: ClothFolding, env_ids: Tensor) -> None:
    """Where the cloth is to be folded, and which way: at its middle, away from the corner that hangs."""
    thing = world.deformables[CLOTH]
    one, other = (thing.key_point(name)[env_ids] for name in PAIRS[0])
    task.fold[env_ids] = 0.5 * (one + other)
    task.ahead[env_ids] = (other - one) / vector_norm(other - one, dim=1, keepdim=True)


def leaning(world: World, task: ClothFolding, position: Tensor, tilt: float) -> Tensor:
    """(N, 7) the hand at a position, its fingers on both sides of the cloth's diagonal, leant towards the fold."""
    ahead = task.ahead
    level = torch.stack((ahead[:, 1], -ahead[:, 0], torch.zeros_like(ahead[:, 0])), dim=1)
    upright = common.facing_down(torch.atan2(ahead[:, 1], ahead[:, 0]))
    return torch.cat((position, quat_multiply(quat_from_rotation_vector(tilt * level), upright)), dim=1)


def at_tip(back: float, up: float) -> TermFunction:
    """Term: (N, 7) the hand around the corner, ``back`` and ``up`` metres from where it takes it."""

    def pose(world: World, task: ClothFolding) -> Tensor:
        position = grip(world, task) - back * task.ahead
        position[:, 2] += up
        return leaning(world, task, position, TAKES)

    return pose


def along_arc(angle: float, up: float = 0.0, back: float = 0.0) -> TermFunction:
    """Term: (N, 7) the hand on its arc over the fold, ``angle`` rad from the tray to the tray again."""

    def pose(world: World, task: ClothFolding) -> Tensor:
        radius = math.sqrt(2.0) * task.size * (0.5 - ROWS / (task.particles - 1))
        position = task.fold + task.ahead * (back - radius * math.cos(angle))
        position[:, 2] = STAND + 0.02 + radius * math.sin(angle) + up
        return leaning(world, task, position, TAKES + (LEAVES - TAKES) * angle / math.pi)

    return pose


@dataclass
class ClothFoldingObservations:
    """Policy and critic see the state."""

    policy: cloth.ClothState = field(default_factory=cloth.ClothState)
    critic: ObservationGroup | None = None


@dataclass
class ClothFoldingRewards(cloth.Smoothness):
    """Rewards of the hand at the corner and of pairs that lie on each other, less what is fast or abrupt."""

    reach: RewardTerm | None = RewardTerm(cloth.reaching(PAIRS[0][0]), 1.0)
    fold: RewardTerm | None = RewardTerm(lambda world, task: common.nearness(distance(world, task), 0.4), 10.0)
    fold_finely: RewardTerm | None = RewardTerm(lambda world, task: common.nearness(distance(world, task), 0.1), 10.0)


@dataclass
class ClothFoldingEvents:
    """Robot and cloth are placed anew for each episode."""

    place_robot: EventTerm | None = EventTerm(common.randomize_robot_start(0.05))
    place_cloth: EventTerm | None = EventTerm(matter.place_deformable(CLOTH, (0.05, 0.01), 0.15))
    remember_fold: EventTerm | None = EventTerm(remember_fold)


@dataclass(kw_only=True)
class ClothFolding(cloth.ClothTask):
    """The cloth lies on a smooth tray with one corner over its edge; that corner is to lie on the opposite one.

    Succeeds when the distances between three pairs of key points add up to less than ``tolerance`` and the gripper
    does not touch the cloth at the episode's end. Metric: that sum.
    """

    episode_length: float = 9.0
    view: Pose = look_at(eye=(1.2, -0.75, 0.65), target=(0.5, 0.0, 0.08))
    bending_stiffness: float = 2e-6
    """N m, of thin cotton: a triangle of this size that is stiffer rolls open again."""
    tolerance: float = 0.09
    """Metres; layers of cloth that touch are 8 mm apart, three pairs of them 2.4 cm."""
    observations: ClothFoldingObservations = field(default_factory=ClothFoldingObservations)
    rewards: ClothFoldingRewards = field(default_factory=ClothFoldingRewards)
    terminations: cloth.TimeLimit = field(default_factory=cloth.TimeLimit)
    events: ClothFoldingEvents = field(default_factory=ClothFoldingEvents)

    fold: Tensor = field(init=False)
    """(N, 3) where the cloth's middle was, in the environment's frame."""
    ahead: Tensor = field(init=False)
    """(N, 3) unit vector from the corner that hangs to the one opposite."""

    def scene(self) -> Scene:
        half = 0.5 * math.sqrt(2.0) * self.size
        width = 2.0 * half - HANGING + 0.1
        edge = -half + HANGING
        flat = self.cloth((0.5, 0.0, STAND), yaw=0.25 * math.pi)
        grip = KeyPoint("grip", (ROWS * (self.particles + 1),))
        soft = replace(flat, bending_stiffness=self.bending_stiffness, key_points=(*flat.key_points, grip))
        return self.on_bench(
            soft,
            cloth.tray((0.5, width, STAND), 0.5, edge + 0.5 * width, ROUGH),
        )

    def start(self, world: World) -> None:
        super().start(world)
        self.fold, self.ahead = (torch.zeros(world.num_envs, 3, device=world.device) for _ in range(2))

    def success(self, world: World) -> Tensor:
        return (distance(world, self) < self.tolerance) & cloth.let_go(world, self)

    def metrics(self, world: World) -> dict[str, Tensor]:
        return {"pair_distance_m": distance(world, self)}

    def expert(self, world: World) -> Expert:
        arc = (math.radians(angle) for angle in (25, 50, 75, 100, 125, 150))
        phases = (
            Phase(at_tip(0.06, 0.05), position_tolerance=0.015, free=True),
            Phase(at_tip(0.0, 0.0), position_tolerance=0.005, timeout=1.5),
            Phase(cloth.still, gripper_open=False, dwell=0.5, timeout=0.5),
            *(Phase(along_arc(angle), False, position_tolerance=0.02, timeout=0.8) for angle in arc),
            Phase(along_arc(math.pi), False, position_tolerance=0.01, dwell=0.5, timeout=1.2),
            Phase(along_arc(math.pi), position_tolerance=1.0, rotation_tolerance=4.0, dwell=0.4),
            Phase(along_arc(math.pi, up=0.1, back=0.1)),
        )
        return Expert(world, self, phases, position_lead=0.04)
