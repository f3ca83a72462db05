"""Cloth-Folding: take a corner of a cloth that lies flat and lay it on the opposite one."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace

import torch
from torch import Tensor
from torch.linalg import vector_norm

from orbit_core.envs import EventTerm, Expert, ObservationGroup, Phase, RewardTerm
from orbit_core.envs.terms import TermFunction, once_per_state
from orbit_core.interfaces import World
from orbit_core.mdp import common, matter
from orbit_core.scene import Cloth, PhysicsMaterial, Pose, Scene, look_at
from orbit_core.scene.pose import Vector3
from orbit_tasks import cloth
from orbit_tasks.cloth import CLOTH, TRAY

PAIRS = (("corner--", "corner++"), ("side-", "back"), ("front", "side+"))
"""Key points that the fold along the other diagonal lays on each other; the first is taken."""
ROUGH = PhysicsMaterial(static_friction=0.6, dynamic_friction=0.6)
TAKEN = 0.02
FURTHER = 0.03
LOW = 0.03
ACROSS = 0.0
ARC = 0.9
LEAN = 0.0


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
    """Where the cloth is to be folded, and which way: at its middle, away from the corner that is taken."""
    thing = world.deformables[CLOTH]
    one, other = (thing.key_point(name)[env_ids] for name in PAIRS[0])
    task.fold[env_ids] = 0.5 * (one + other)
    task.ahead[env_ids] = (other - one) / vector_norm(other - one, dim=1, keepdim=True)


def hand_at(world: World, task: ClothFolding, position: Tensor, height) -> Tensor:
    ahead = task.ahead
    yaw = torch.atan2(ahead[:, 1], ahead[:, 0]) - 0.5 * math.pi + ACROSS
    position = position.clone()
    position[:, 2] = height
    return torch.cat((position, common.facing_down(yaw)), dim=1)


def at_corner(height) -> TermFunction:
    def pose(world: World, task: ClothFolding) -> Tensor:
        point = world.deformables[CLOTH].key_point(PAIRS[0][0])
        return hand_at(world, task, point + TAKEN * task.ahead, height)

    return pose


def along_arc(angle: float, base: float) -> TermFunction:
    def pose(world: World, task: ClothFolding) -> Tensor:
        radius = 0.5 * math.sqrt(2.0) * task.size - TAKEN
        position = task.fold - task.ahead * radius * math.cos(angle)
        return hand_at(world, task, position, (base + ARC * radius * math.sin(angle)).squeeze(-1)
                       if isinstance(radius, Tensor) else base + ARC * radius * math.sin(angle))

    return pose


def laid(height, further=None) -> TermFunction:
    def pose(world: World, task: ClothFolding) -> Tensor:
        point = world.deformables[CLOTH].key_point(PAIRS[0][1])
        point = task.fold + task.ahead * 0.5 * math.sqrt(2.0) * task.size
        return hand_at(world, task, point + task.ahead * ((FURTHER if further is None else further) - TAKEN), height)

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
    place_cloth: EventTerm | None = EventTerm(matter.place_deformable(CLOTH, (0.04, 0.04), 0.3))
    remember_fold: EventTerm | None = EventTerm(remember_fold)


@dataclass(kw_only=True)
class ClothFolding(cloth.ClothTask):
    """The cloth lies flat on a tray."""

    episode_length: float = 10.0
    view: Pose = look_at(eye=(1.2, 0.3, 0.55), target=(0.5, 0.0, 0.05))
    size: float = 0.24
    particles: int = 25
    """Along each side."""
    area_density: float = 0.3
    bending_stiffness: float = 5e-6
    tray_friction: float = 0.6
    tolerance: float = 0.036
    """Metres."""
    observations: ClothFoldingObservations = field(default_factory=ClothFoldingObservations)
    rewards: ClothFoldingRewards = field(default_factory=ClothFoldingRewards)
    terminations: cloth.TimeLimit = field(default_factory=cloth.TimeLimit)
    events: ClothFoldingEvents = field(default_factory=ClothFoldingEvents)

    fold: Tensor = field(init=False)
    """(N, 3) where the cloth's middle was, in the environment's frame."""
    ahead: Tensor = field(init=False)
    """(N, 3) unit vector from the corner that is taken to the one opposite."""

    def scene(self) -> Scene:
        flat = self.cloth((0.5, 0.0, TRAY), yaw=0.25 * math.pi)
        soft = replace(flat, bending_stiffness=self.bending_stiffness)
        mat = PhysicsMaterial(static_friction=self.tray_friction, dynamic_friction=self.tray_friction)
        return self.on_bench(soft, cloth.tray((0.5, 0.6, TRAY), 0.5, material=mat))

    def start(self, world: World) -> None:
        super().start(world)
        self.fold, self.ahead = (torch.zeros(world.num_envs, 3, device=world.device) for _ in range(2))

    def success(self, world: World) -> Tensor:
        return (pair_distances(world, self) < self.tolerance).all(1) & cloth.let_go(world, self)

    def metrics(self, world: World) -> dict[str, Tensor]:
        return {"pair_distance_m": distance(world, self)}

    def expert(self, world: World) -> Expert:
        opened, closed = (TRAY - cloth.PRESSED + cloth.finger_reach(world, shut) for shut in (False, True))
        arc = (math.radians(angle) for angle in (25, 50, 75, 100, 125, 150))
        low = TRAY + LOW + cloth.finger_reach(world, False)
        phases = (
            Phase(at_corner(opened + 0.1), position_tolerance=0.02, free=True),
            Phase(at_corner(opened), position_tolerance=0.008, timeout=1.0),
            Phase(cloth.still_at(closed), gripper_open=False, dwell=0.7, timeout=0.7),
            *(Phase(along_arc(angle, closed + 0.02), False, position_tolerance=0.02, timeout=1.2) for angle in arc),
            Phase(laid(low), False, position_tolerance=0.01, dwell=0.5, timeout=1.2),
            Phase(laid(low), position_tolerance=1.0, rotation_tolerance=4.0, dwell=0.4),
            Phase(laid(low + 0.1)),
        )
        return Expert(world, self, phases, position_lead=0.04)
