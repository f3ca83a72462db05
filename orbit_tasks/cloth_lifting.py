"""Cloth-Lifting: pinch a cloth that lies flat on a tray and hold its middle at a sampled position."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import ClassVar

import torch
from torch import Tensor
from torch.linalg import vector_norm

from orbit_core.envs import EventTerm, ObservationGroup, ObservationTerm, RewardTerm
from orbit_core.envs.task_checks import TaskCheck, TaskException
from orbit_core.envs.terms import ENVIRONMENT, Meaning, once_per_state
from orbit_core.interfaces import World
from orbit_core.mdp import common
from orbit_core.scene import MarkerShape, MarkerSpec, Pose, Scene, look_at
from orbit_motion.experts import Expert, Phase
from orbit_tasks import cloth
from orbit_tasks.cloth import CLOTH, TRAY, middle
from orbit_tasks.mdp import matter


@once_per_state
def goal_distance(world: World, task: ClothLifting) -> Tensor:
    """(N,) metres between the cloth's middle and the goal."""
    return vector_norm(task.goal - middle(world, task), dim=1)


def lifted(world: World, task: ClothLifting) -> Tensor:
    """(N,) 1 where the cloth's middle is 5 cm above the tray, else 0."""
    return (middle(world, task)[:, 2] > TRAY + 0.05).float()


def tracking(world: World, task: ClothLifting, scale: float) -> Tensor:
    """(N,) in [0, 1]: how near the lifted middle is to the goal."""
    return lifted(world, task) * common.nearness(goal_distance(world, task), scale)


def sample_goal(world: World, task: ClothLifting, env_ids: Tensor) -> None:
    """Sample the goal 20 to 35 cm above the table, within 10 cm of the tray's middle each way."""
    x = world.scene.deformables[0].pose.position[0]
    task.goal[env_ids] = world.random.uniform((3,), (x - 0.1, -0.1, 0.2), (x + 0.05, 0.1, 0.35), env_ids)
    common.place_markers(world, ("goal",), task.goal[env_ids][:, None], env_ids)


def at_goal(world: World, task: ClothLifting) -> Tensor:
    """(N, 7) the hand where the cloth's middle comes to the goal, as it hangs in the hand now."""
    return common.pointing_down(task.goal + common.hand_pose(world, task)[:, :3] - middle(world, task))


@dataclass
class ClothLiftingState(cloth.ClothState):
    """The arm's joints and hand, the cloth's key points, the last action and the goal."""

    goal: ObservationTerm | None = ObservationTerm(
        lambda world, task: task.goal,
        unit="m",
        meaning=Meaning("position that the cloth is to be lifted to", ENVIRONMENT),
    )


@dataclass
class ClothLiftingObservations:
    """Policy and critic see the state."""

    policy: ClothLiftingState = field(default_factory=ClothLiftingState)
    critic: ObservationGroup | None = None


@dataclass
class ClothLiftingRewards(cloth.Smoothness):
    """Rewards of the hand at the cloth, the cloth off the tray and at its goal, less what is fast or abrupt."""

    reach: RewardTerm | None = RewardTerm(cloth.reaching("middle"), 1.0)
    lift: RewardTerm | None = RewardTerm(lifted, 10.0)
    track: RewardTerm | None = RewardTerm(lambda world, task: tracking(world, task, 0.3), 16.0)
    track_finely: RewardTerm | None = RewardTerm(lambda world, task: tracking(world, task, 0.05), 5.0)


@dataclass
class ClothLiftingEvents:
    """Robot, cloth and goal are placed anew for each episode."""

    place_robot: EventTerm | None = EventTerm(common.randomize_robot_start(0.05))
    place_cloth: EventTerm | None = EventTerm(matter.place_deformable(CLOTH, (0.05, 0.05)))
    sample_goal: EventTerm | None = EventTerm(sample_goal)


@dataclass(kw_only=True)
class ClothLifting(cloth.ClothTask):
    """The cloth lies flat on a smooth tray, anywhere within 5 cm and turned by any angle.

    Succeeds when the cloth's middle is within ``tolerance`` of the goal at the episode's end. Metric: that distance.
    """

    exceptions: ClassVar[tuple[TaskException, ...]] = (
        TaskException(TaskCheck.START_YAW, "deformables are sampled by their middle, which has no yaw"),
    )
    episode_length: float = 6.0
    view: Pose = look_at(eye=(1.3, 0.8, 0.7), target=(0.45, 0.0, 0.12))
    tolerance: float = 0.03
    """Metres."""
    observations: ClothLiftingObservations = field(default_factory=ClothLiftingObservations)
    rewards: ClothLiftingRewards = field(default_factory=ClothLiftingRewards)
    terminations: cloth.TimeLimit = field(default_factory=cloth.TimeLimit)
    events: ClothLiftingEvents = field(default_factory=ClothLiftingEvents)
    goal: Tensor = field(init=False)
    """(N, 3) in the environment's frame."""

    def scene(self) -> Scene:
        return self.on_bench(
            self.cloth((0.5, 0.0, TRAY)),
            cloth.tray((0.5, 0.6, TRAY), 0.5),
            markers=(MarkerSpec("goal", MarkerShape.SPHERE, size=0.03),),
        )

    def start(self, world: World) -> None:
        super().start(world)
        self.goal = torch.zeros(world.num_envs, 3, device=world.device)

    def success(self, world: World) -> Tensor:
        return goal_distance(world, self) < self.tolerance

    def metrics(self, world: World) -> dict[str, Tensor]:
        return {"goal_distance_m": goal_distance(world, self)}

    def expert(self, world: World) -> Expert:
        phases = (*cloth.pinching(world), Phase(at_goal, gripper_open=False))
        return Expert(world, self, phases, position_lead=0.05)
