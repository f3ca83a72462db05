"""Cloth-Spreading: draw the corners of a crumpled cloth apart until it is spread on its tray."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import ClassVar

import torch
from torch import Tensor
from torch.linalg import vector_norm

from orbit_core.envs import Environment, EventTerm, ObservationGroup, RewardTerm
from orbit_core.envs.state import TaskState
from orbit_core.envs.task import TaskCheck, TaskException, TaskMetadata
from orbit_core.envs.terms import TermFunction, once_per_state
from orbit_core.mdp import common
from orbit_core.scene import Scene, look_at
from orbit_motion.experts import Expert, Phase
from orbit_tasks import cloth
from orbit_tasks.cloth import CLOTH, TRAY
from orbit_tasks.mdp import matter
from orbit_tasks.mdp.crumpled import crumpled

# Key points that the expert draws outwards, in this order.
STROKES = ("corner++", "corner--", "corner+-", "corner-+")
# How often it does so.
ROUNDS = 3
# Share of its area that the cloth covers when the expert leaves it alone.
DONE = 0.93
# Metres from the tray's middle, each way, to which the expert lets the cloth's middle go.
ASTRAY = 0.05
# How far it draws a corner, in parts of the way from the cloth's middle to where the corner is when it is flat.
FURTHER = 1.1


class SpreadMemory(TaskState):
    """State of a cloth: its crumpled starts, and its flat shape."""

    starts: Tensor
    """(S, P, 3) in which the cloth may lie crumpled, around x = y = 0."""
    flat: Tensor
    """(K, 2) the key points of the flat cloth."""

    def start(self, env: Environment) -> None:
        self.starts = crumpled(env.world, CLOTH)
        spec = env.world.scene.deformables[0]
        rest = torch.as_tensor(spec.rest_positions[:, :2], dtype=torch.float32, device=env.device)
        self.flat = torch.stack([rest[list(point.particles)].mean(0) for point in spec.key_points])


@once_per_state
def covered(env: Environment[ClothSpreading]) -> Tensor:
    """(N,) the area that the cloth covers, seen from above, as share of its area."""
    return env.world.deformables[CLOTH].covered_area / env.task.size**2


@once_per_state
def flat_frame(env: Environment[ClothSpreading, SpreadMemory]) -> Tensor:
    """(N, 4) x, y and yaw that the flat cloth would have, and 1 with its upper side up or -1 with that side down.

    Of all such frames, that at which its key points are nearest. Least squares in the plane: yaw from the sums of dot
    and cross products of the key points as they are and as they would be.
    """
    points = env.world.deformables[CLOTH].key_points[..., :2]
    middle = points.mean(1)
    arms, (x, y) = points - middle[:, None], env.state.flat.unbind(1)
    # (N, 2), both ways up: half of all cloths fall on their upper side, and strokes do not turn them over.
    side = torch.tensor([1.0, -1.0], device=env.device)
    dot = (arms[..., 0] * x).sum(1, keepdim=True) + side * (arms[..., 1] * y).sum(1, keepdim=True)
    turned = (arms[..., 1] * x).sum(1, keepdim=True) - side * (arms[..., 0] * y).sum(1, keepdim=True)
    nearer = (dot**2 + turned**2).argmax(1, keepdim=True)
    yaw = torch.atan2(turned.gather(1, nearer), dot.gather(1, nearer))
    return torch.cat((middle, yaw, side[nearer]), dim=1)


def place_of(name: str) -> TermFunction:
    """Term: (N, 3) where a key point is drawn to, on the tray."""

    def place(env: Environment[ClothSpreading, SpreadMemory]) -> Tensor:
        spec = env.world.deformables[CLOTH].spec
        frame = flat_frame(env)
        x, y = (FURTHER * env.state.flat[[point.name for point in spec.key_points].index(name)]).unbind()
        y = frame[:, 3] * y  # a cloth that lies on its upper side is seen mirrored
        sine, cosine = frame[:, 2].sin(), frame[:, 2].cos()
        place = torch.stack((cosine * x - sine * y, sine * x + cosine * y, torch.full_like(sine, TRAY)), dim=1)
        middle = torch.tensor(spec.pose.position[:2], device=env.device)
        place[:, :2] += middle + (frame[:, :2] - middle).clamp(-ASTRAY, ASTRAY)
        return place

    return place


def until_spread(target: TermFunction) -> TermFunction:
    """Term: (N, 7) the target, or the hand raised where it is once nothing is left to do."""
    raised = cloth.here(0.2)

    def pose(env: Environment[ClothSpreading]) -> Tensor:
        done = (covered(env) > DONE)[:, None]
        return torch.where(done, raised(env), target(env))

    return pose


def stroke(name: str, pressed: float) -> tuple[Phase, ...]:
    """Phases that press the closed fingers on a key point, the hand at a height, draw it outwards and let it go."""
    point, place = cloth.key_point(name), place_of(name)
    return (
        Phase(until_spread(cloth.over(point, TRAY + 0.07)), False, position_tolerance=0.015, timeout=1.2),
        Phase(until_spread(cloth.over(point, pressed)), False, position_tolerance=0.008, timeout=0.6),
        Phase(until_spread(cloth.over(place, pressed)), False, position_tolerance=0.01, timeout=0.8),
        # Closed fingers that press on cloth catch it between them, and it would rise with them and fold again. They
        # open once they are off the tray: on it they would sweep the cloth along.
        Phase(until_spread(cloth.here(pressed + 0.03)), False, position_tolerance=0.01, timeout=0.3),
        Phase(until_spread(cloth.here(TRAY + 0.07)), position_tolerance=0.03, dwell=0.25, timeout=0.5),
    )


def reaching(env: Environment[ClothSpreading]) -> Tensor:
    """(N,) in [0, 1]: how near the hand is to the nearest corner."""
    corners = env.world.deformables[CLOTH].key_points[:, : len(STROKES)]
    away = vector_norm(corners - common.hand_pose(env)[:, None, :3], dim=2)
    return common.nearness(away.amin(1), 0.1)


@dataclass
class ClothSpreadingObservations:
    """State that ``policy`` sees, and ``critic`` as well unless it is given another group."""

    policy: cloth.ClothState = field(default_factory=cloth.ClothState)
    critic: ObservationGroup | None = None


@dataclass
class ClothSpreadingRewards(cloth.Smoothness):
    """Rewards of the hand at a corner and of the covered area, less what is fast or abrupt."""

    reach: RewardTerm | None = RewardTerm(reaching, 1.0)
    cover: RewardTerm | None = RewardTerm(covered, 10.0)


@dataclass
class ClothSpreadingEvents:
    """Robot and cloth are placed for each episode, the cloth crumpled in one of several ways."""

    place_robot: EventTerm | None = EventTerm(common.randomize_robot_start(0.05))
    place_cloth: EventTerm | None = EventTerm(matter.place_chosen(CLOTH, lambda env: env.state.starts, (0.03, 0.03)))


@dataclass(kw_only=True)
class ClothSpreading(cloth.ClothTask):
    """The cloth is crumpled on a smooth tray, as it fell there, turned by any angle.

    Succeeds when it covers ``least_covered`` of its area at the episode's end. Metric: that share.
    """

    state_type: ClassVar[type[TaskState]] = SpreadMemory
    metadata: TaskMetadata = replace(
        cloth.ClothTask.metadata,
        view=look_at(eye=(1.2, 0.7, 0.75), target=(0.5, 0.0, 0.03)),
        expert_success=0.6,
        exceptions=(
            TaskException(TaskCheck.START_AREA, "a cloth that is spread fills its tray: it starts on 36 cm²"),
            TaskException(TaskCheck.START_YAW, "deformables are sampled by their middle, which has no yaw"),
        ),
    )
    episode_length: float = 20.0
    least_covered: float = 0.8
    observations: ClothSpreadingObservations = field(default_factory=ClothSpreadingObservations)
    rewards: ClothSpreadingRewards = field(default_factory=ClothSpreadingRewards)
    terminations: cloth.TimeLimit = field(default_factory=cloth.TimeLimit)
    events: ClothSpreadingEvents = field(default_factory=ClothSpreadingEvents)

    def scene(self) -> Scene:
        return self.on_bench(self.cloth((0.5, 0.0, TRAY)), cloth.tray((0.5, 0.6, TRAY), 0.5))

    def success(self, env: Environment) -> Tensor:
        return covered(env) >= self.least_covered

    def metrics(self, env: Environment) -> dict[str, Tensor]:
        return {"covered": covered(env)}

    def expert(self, env: Environment) -> Expert:
        pressed = TRAY - cloth.PRESSED + cloth.finger_reach(env.world, closed=True)
        strokes = (phase for _ in range(ROUNDS) for name in STROKES for phase in stroke(name, pressed))
        first = Phase(cloth.over(cloth.middle, TRAY + 0.12), False, position_tolerance=0.03, free=True)
        phases = (first, *strokes, Phase(cloth.here(0.2), False))
        return Expert(env, phases, position_lead=0.05)
