"""Cloth-Dropping: pinch a cloth that is flat on a tray and drop it into a container next to it."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import torch
from torch import Tensor

from orbit_assets.deformables import open_box
from orbit_core.envs import Environment, EventTerm, ObservationGroup, ObservationTerm, RewardTerm
from orbit_core.envs.task import TaskCheck, TaskException, TaskMetadata
from orbit_core.envs.terms import measured_in, once_per_state
from orbit_core.mdp import common
from orbit_core.scene import Pose, Region, Scene, look_at
from orbit_motion.experts import Expert, Phase, Retry
from orbit_tasks import cloth
from orbit_tasks.cloth import CARRIED, CLOTH, TRAY, middle
from orbit_tasks.mdp import matter

CONTAINER = "container"
# Metres within the container.
INNER = (0.18, 0.18, 0.12)
# Metres from the table to the hand as it opens: the cloth, which hangs 10 cm below it, is in the container then.
LOWERED = 0.15


@measured_in("m")
@once_per_state
def container(env: Environment[ClothDropping]) -> Tensor:
    """(N, 3) the middle of the container's floor."""
    return env.world.objects[CONTAINER].root_pose[:, :3]


@once_per_state
def distance(env: Environment[ClothDropping]) -> Tensor:
    """(N,) metres between the cloth's middle and the container's, seen from above and, out of it, in height."""
    away = middle(env) - container(env)
    # Below the rim height does not count: cloth may be flat on the floor or in a heap.
    above = (away[:, 2] - INNER[2]).clamp_min(0.0)
    return torch.sqrt(away[:, 0] ** 2 + away[:, 1] ** 2 + above**2)


@once_per_state
def inside(env: Environment[ClothDropping]) -> Tensor:
    """(N,) in [0, 1]: the part of the cloth that is in the container."""
    half = Pose((0.0, 0.0, 0.5 * INNER[2]))
    # Walls and 2 cm above the rim count as inside: cloth leans on the one and stands out of the other.
    region = Region((0.5 * INNER[0] + 0.01, 0.5 * INNER[1] + 0.01, 0.5 * INNER[2] + 0.02), half, CONTAINER, CONTAINER)
    return env.world.deformables[CLOTH].share_inside(region)


def dropped(env: Environment[ClothDropping]) -> Tensor:
    """(N,) bool: whether the cloth is in the container and off the hand."""
    return cloth.let_go(env) & (inside(env) >= env.task.least_inside)


def place_container(env: Environment[ClothDropping], env_ids: Tensor) -> None:
    """Place the container up to 4 cm off its place each way."""
    thing = env.world.objects[CONTAINER]
    shift = env.world.random.uniform((2,), -0.04, 0.04, env_ids)
    x, y, z = thing.spec.pose.position
    pose = torch.tensor([x, y, z, 1.0, 0.0, 0.0, 0.0], device=env.device).repeat(len(env_ids), 1)
    pose[:, :2] += shift
    thing.set_root_pose(pose, env_ids)


@dataclass
class ClothDroppingState(cloth.ClothState):
    """The arm's joints and hand, the cloth's key points, the last action and the container."""

    container: ObservationTerm | None = ObservationTerm(container)


@dataclass
class ClothDroppingObservations:
    """State that ``policy`` sees, and ``critic`` as well unless it is given another group."""

    policy: ClothDroppingState = field(default_factory=ClothDroppingState)
    critic: ObservationGroup | None = None


@dataclass
class ClothDroppingRewards(cloth.Smoothness):
    """Rewards of the hand at the cloth, the cloth near the container and in it, less what is fast or abrupt."""

    reach: RewardTerm | None = RewardTerm(cloth.reaching("middle"), 1.0)
    bring: RewardTerm | None = RewardTerm(lambda env: common.nearness(distance(env), 0.3), 8.0)
    """Nearness of the cloth's middle to the container's, within some 0.3 m."""
    drop: RewardTerm | None = RewardTerm(inside, 16.0)


@dataclass
class ClothDroppingEvents:
    """Robot, cloth and container are placed for each episode."""

    place_robot: EventTerm | None = EventTerm(common.randomize_robot_start(0.05))
    place_cloth: EventTerm | None = EventTerm(matter.place_deformable(CLOTH, (0.05, 0.05)))
    place_container: EventTerm | None = EventTerm(place_container)


@dataclass(kw_only=True)
class ClothDropping(cloth.ClothTask):
    """The cloth is flat on a smooth tray, anywhere within 5 cm and turned by any angle; the container is next to it.

    Succeeds when its middle is within ``tolerance`` of the container's, ``least_inside`` of it is in the container and
    the gripper does not touch it at the episode's end. Metric: that distance.
    """

    metadata: TaskMetadata = replace(
        cloth.ClothTask.metadata,
        view=look_at(eye=(1.3, 0.9, 0.75), target=(0.45, 0.12, 0.08)),
        exceptions=(
            TaskException(TaskCheck.START_AREA, "tray and container take the workspace: the cloth starts on 100 cm²"),
            TaskException(TaskCheck.START_YAW, "deformables are sampled by their middle, which has no yaw"),
        ),
    )
    grip_force: float = 5.0
    """Newtons; harder, and corners of the fingers come through the cloth, which then hangs on them as they open."""
    episode_length: float = 11.0
    particles: int = 25
    """Along each side; no further apart than half a pad's width, or fingers poke through the cloth and stay in it."""
    tolerance: float = 0.08
    """Metres."""
    least_inside: float = 0.8
    observations: ClothDroppingObservations = field(default_factory=ClothDroppingObservations)
    rewards: ClothDroppingRewards = field(default_factory=ClothDroppingRewards)
    terminations: cloth.TimeLimit = field(default_factory=cloth.TimeLimit)
    events: ClothDroppingEvents = field(default_factory=ClothDroppingEvents)

    def scene(self) -> Scene:
        return self.on_bench(
            self.cloth((0.48, -0.08, TRAY)),
            cloth.tray((0.45, 0.45, TRAY), 0.48, -0.08),
            open_box(CONTAINER, INNER, Pose((0.48, 0.29, 0.005)), material=cloth.SMOOTH),
        )

    def success(self, env: Environment) -> Tensor:
        return (distance(env) < self.tolerance) & dropped(env)

    def metrics(self, env: Environment) -> dict[str, Tensor]:
        return {"container_distance_m": distance(env), "inside": inside(env)}

    def expert(self, env: Environment) -> Expert:
        above, within = cloth.over(container, CARRIED), cloth.over(container, LOWERED)
        # Cloth at times hangs on a finger that has opened, and rises with it: take it down again.
        again = Retry(2, dropped, most=3)
        phases = (
            *cloth.pinching(env.world),
            Phase(cloth.here(CARRIED), gripper_open=False, position_tolerance=0.03, timeout=1.0),
            Phase(above, gripper_open=False, position_tolerance=0.02, timeout=2.0),
            Phase(within, gripper_open=False, position_tolerance=0.015, dwell=0.4, timeout=1.2),
            Phase(within, position_tolerance=1.0, dwell=0.3),
            Phase(cloth.over(container, LOWERED + 0.1), position_tolerance=0.03, timeout=1.2, retry=again),
            Phase(above),
        )
        return Expert(env, phases, position_lead=0.05)
