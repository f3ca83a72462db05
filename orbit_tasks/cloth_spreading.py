"""Cloth-Spreading: draw the corners of a crumpled cloth apart until it lies spread on its tray."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import ClassVar

import torch
from torch import Tensor
from torch.linalg import vector_norm

from orbit_core.envs import EventTerm, ObservationGroup, RewardTerm
from orbit_core.envs.task_checks import TaskCheck, TaskException
from orbit_core.envs.terms import TermFunction, once_per_state
from orbit_core.interfaces import World
from orbit_core.mdp import common
from orbit_core.scene import Pose, Scene, look_at
from orbit_motion.experts import Expert, Phase
from orbit_tasks import cloth
from orbit_tasks.cloth import CLOTH, TRAY
from orbit_tasks.mdp import matter
from orbit_tasks.mdp.crumpled import crumpled

STROKES = ("corner++", "corner--", "corner+-", "corner-+")
"""Key points that the expert draws outwards, in this order."""
ROUNDS = 3
"""How often it does so."""
DONE = 0.93
"""Share of its area that the cloth covers when the expert leaves it alone."""
ASTRAY = 0.05
"""Metres from the tray's middle, each way, to which the expert lets the cloth's middle go."""
FURTHER = 1.1
"""How far it draws a corner, in parts of the way from the cloth's middle to where the corner lies when it is flat."""


@once_per_state
def covered(world: World, task: ClothSpreading) -> Tensor:
    """(N,) the area that the cloth covers, seen from above, as share of its own."""
    return world.deformables[CLOTH].covered_area / task.size**2


@once_per_state
def flat_frame(world: World, task: ClothSpreading) -> Tensor:
    """(N, 3) x, y and yaw that the flat cloth would have: of all, those at which its key points are nearest.

    Least squares in the plane: yaw from the sums of dot and cross products of what is and what would be.
    """
    points = world.deformables[CLOTH].key_points[..., :2]
    middle = points.mean(1)
    arms = points - middle[:, None]
    dot = (arms * task.flat).sum((1, 2))
    turned = (task.flat[..., 0] * arms[..., 1] - task.flat[..., 1] * arms[..., 0]).sum(1)
    return torch.cat((middle, torch.atan2(turned, dot)[:, None]), dim=1)


def place_of(name: str) -> TermFunction:
    """Term: (N, 3) where a key point is drawn to, on the tray."""

    def place(world: World, task: ClothSpreading) -> Tensor:
        spec = world.deformables[CLOTH].spec
        x, y = (FURTHER * task.flat[[point.name for point in spec.key_points].index(name)]).unbind()
        frame = flat_frame(world, task)
        sine, cosine = frame[:, 2].sin(), frame[:, 2].cos()
        place = torch.stack((cosine * x - sine * y, sine * x + cosine * y, torch.full_like(sine, TRAY)), dim=1)
        middle = torch.tensor(spec.pose.position[:2], device=world.device)
        place[:, :2] += middle + (frame[:, :2] - middle).clamp(-ASTRAY, ASTRAY)
        return place

    return place


def until_spread(target: TermFunction) -> TermFunction:
    """Term: (N, 7) the target, or the hand raised where it is once nothing is left to do."""
    raised = cloth.here(0.2)

    def pose(world: World, task: ClothSpreading) -> Tensor:
        done = (covered(world, task) > DONE)[:, None]
        return torch.where(done, raised(world, task), target(world, task))

    return pose


def stroke(name: str, pressed: float) -> tuple[Phase, ...]:
    """Phases that press the closed fingers on a key point, the hand at a height, and draw it outwards."""
    point, place = cloth.key_point(name), place_of(name)
    return (
        Phase(until_spread(cloth.over(point, TRAY + 0.07)), False, position_tolerance=0.015, timeout=1.2),
        Phase(until_spread(cloth.over(point, pressed)), False, position_tolerance=0.008, timeout=0.6),
        Phase(until_spread(cloth.over(place, pressed)), False, position_tolerance=0.01, timeout=0.8),
        Phase(until_spread(cloth.here(TRAY + 0.07)), False, position_tolerance=0.03, timeout=0.5),
    )


def reaching(world: World, task: ClothSpreading) -> Tensor:
    """(N,) in [0, 1]: how near the hand is to the nearest corner."""
    corners = world.deformables[CLOTH].key_points[:, : len(STROKES)]
    away = vector_norm(corners - common.hand_pose(world, task)[:, None, :3], dim=2)
    return common.nearness(away.amin(1), 0.1)


@dataclass
class ClothSpreadingObservations:
    """Policy and critic see the state."""

    policy: cloth.ClothState = field(default_factory=cloth.ClothState)
    critic: ObservationGroup | None = None


@dataclass
class ClothSpreadingRewards(cloth.Smoothness):
    """Rewards of the hand at a corner and of the covered area, less what is fast or abrupt."""

    reach: RewardTerm | None = RewardTerm(reaching, 1.0)
    cover: RewardTerm | None = RewardTerm(covered, 10.0)


@dataclass
class ClothSpreadingEvents:
    """Robot and cloth are placed anew for each episode, the cloth crumpled in one of several ways."""

    place_robot: EventTerm | None = EventTerm(common.randomize_robot_start(0.05))
    place_cloth: EventTerm | None = EventTerm(matter.place_chosen(CLOTH, lambda task: task.starts, (0.03, 0.03)))


@dataclass(kw_only=True)
class ClothSpreading(cloth.ClothTask):
    """The cloth lies crumpled on a smooth tray, as it fell there, turned by any angle.

    Succeeds when it covers ``least_covered`` of its own area at the episode's end. Metric: that share.
    """

    exceptions: ClassVar[tuple[TaskException, ...]] = (
        TaskException(TaskCheck.START_AREA, "a cloth that is spread fills its tray: it starts on 36 cm²"),
        TaskException(TaskCheck.START_YAW, "deformables are sampled by their middle, which has no yaw"),
    )
    expert_success: ClassVar[float] = 0.6
    episode_length: float = 20.0
    view: Pose = look_at(eye=(1.2, 0.7, 0.75), target=(0.5, 0.0, 0.03))
    least_covered: float = 0.8
    observations: ClothSpreadingObservations = field(default_factory=ClothSpreadingObservations)
    rewards: ClothSpreadingRewards = field(default_factory=ClothSpreadingRewards)
    terminations: cloth.TimeLimit = field(default_factory=cloth.TimeLimit)
    events: ClothSpreadingEvents = field(default_factory=ClothSpreadingEvents)
    starts: Tensor = field(init=False)
    """(S, P, 3) in which the cloth may lie crumpled, around x = y = 0."""
    flat: Tensor = field(init=False)
    """(K, 2) the key points of the flat cloth."""

    def scene(self) -> Scene:
        return self.on_bench(self.cloth((0.5, 0.0, TRAY)), cloth.tray((0.5, 0.6, TRAY), 0.5))

    def start(self, world: World) -> None:
        super().start(world)
        self.starts = crumpled(world, CLOTH)
        spec = world.scene.deformables[0]
        rest = torch.as_tensor(spec.rest_positions[:, :2], dtype=torch.float32, device=world.device)
        self.flat = torch.stack([rest[list(point.particles)].mean(0) for point in spec.key_points])

    def success(self, world: World) -> Tensor:
        return covered(world, self) >= self.least_covered

    def metrics(self, world: World) -> dict[str, Tensor]:
        return {"covered": covered(world, self)}

    def expert(self, world: World) -> Expert:
        pressed = TRAY - cloth.PRESSED + cloth.finger_reach(world, closed=True)
        strokes = (phase for _ in range(ROUNDS) for name in STROKES for phase in stroke(name, pressed))
        first = Phase(cloth.over(cloth.middle, TRAY + 0.12), False, position_tolerance=0.03, free=True)
        phases = (first, *strokes, Phase(cloth.here(0.2), False))
        return Expert(world, self, phases, position_lead=0.05)
