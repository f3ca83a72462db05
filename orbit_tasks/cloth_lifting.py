"""Cloth-Lifting: pinch a cloth that is flat on a tray and hold its middle at a sampled position."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import ClassVar

from torch import Tensor
from torch.linalg import vector_norm

from orbit_core.envs import CommandTerm, Environment, EventTerm, ObservationGroup, ObservationTerm, RewardTerm
from orbit_core.envs.task import TaskCheck, TaskException, TaskMetadata
from orbit_core.envs.terms import ENVIRONMENT, Bounds, Meaning, once_per_state
from orbit_core.mdp import common
from orbit_core.mdp.commands import UniformPositionCommand, generated_command
from orbit_core.scene import MarkerShape, MarkerSpec, Scene, look_at
from orbit_motion.experts import Expert, Phase
from orbit_tasks import cloth
from orbit_tasks.cloth import CLOTH, TRAY, middle
from orbit_tasks.mdp import matter


@once_per_state
def goal_distance(env: Environment[ClothLifting]) -> Tensor:
    """(N,) metres between the cloth's middle and the goal."""
    return vector_norm(env.commands["goal"] - middle(env), dim=1)


def lifted(env: Environment[ClothLifting]) -> Tensor:
    """(N,) 1 where the cloth's middle is 5 cm above the tray, else 0."""
    return (middle(env)[:, 2] > TRAY + 0.05).float()


def tracking(env: Environment[ClothLifting], scale: float) -> Tensor:
    """(N,) in [0, 1]: how near the lifted middle is to the goal."""
    # Counts once it is lifted: cloth that is pushed along the tray comes nearer as well.
    return lifted(env) * common.nearness(goal_distance(env), scale)


@dataclass(unsafe_hash=True, kw_only=True)
class ClothGoal(UniformPositionCommand):
    """Position 20 to 35 cm above the table, within 10 cm of the tray's middle each way."""

    def reach(self, env: Environment) -> dict[str, Bounds]:
        x = env.world.scene.deformables[0].pose.position[0]
        return {"x": (x - 0.1, x + 0.05), "y": (-0.1, 0.1), "z": (0.2, 0.35)}


def at_goal(env: Environment[ClothLifting]) -> Tensor:
    """(N, 7) the hand where the cloth's middle is at the goal, as it hangs in the hand now."""
    return common.pointing_down(env.commands["goal"] + common.hand_pose(env)[:, :3] - middle(env))


@dataclass
class ClothLiftingState(cloth.ClothState):
    """The arm's joints and hand, the cloth's key points, the last action and the goal."""

    goal: ObservationTerm | None = ObservationTerm(
        generated_command("goal"),
        unit="m",
        meaning=Meaning("position that the cloth is to be lifted to", ENVIRONMENT),
    )


@dataclass
class ClothLiftingObservations:
    """State that ``policy`` sees, and ``critic`` as well unless it is given another group."""

    policy: ClothLiftingState = field(default_factory=ClothLiftingState)
    critic: ObservationGroup | None = None


@dataclass
class ClothLiftingRewards(cloth.Smoothness):
    """Rewards of the hand at the cloth, the cloth off the tray and at its goal, less what is fast or abrupt."""

    reach: RewardTerm | None = RewardTerm(cloth.reaching("middle"), 1.0)
    lift: RewardTerm | None = RewardTerm(lifted, 10.0)
    track: RewardTerm | None = RewardTerm(lambda env: tracking(env, 0.3), 16.0)
    """Nearness of the lifted middle to the goal, within some 0.3 m."""
    track_finely: RewardTerm | None = RewardTerm(lambda env: tracking(env, 0.05), 5.0)
    """The same within 0.05 m, which decides the last centimetres."""


@dataclass
class ClothLiftingCommands:
    """The position that the cloth's middle is to be brought to."""

    goal: CommandTerm | None = ClothGoal(marker="goal")


@dataclass
class ClothLiftingEvents:
    """Robot and cloth are placed for each episode."""

    place_robot: EventTerm | None = EventTerm(common.randomize_robot_start(0.05))
    place_cloth: EventTerm | None = EventTerm(matter.place_deformable(CLOTH, (0.05, 0.05)))


@dataclass(kw_only=True)
class ClothLifting(cloth.ClothTask):
    """The cloth is flat on a smooth tray, anywhere within 5 cm and turned by any angle.

    Succeeds when the cloth's middle is within ``tolerance`` of the goal at the episode's end. Metric: that distance.
    """

    renamed: ClassVar[Mapping[str, str]] = {"events.sample_goal": "commands.goal"}
    metadata: TaskMetadata = replace(
        cloth.ClothTask.metadata,
        view=look_at(eye=(1.3, 0.8, 0.7), target=(0.45, 0.0, 0.12)),
        exceptions=(TaskException(TaskCheck.START_YAW, "deformables are sampled by their middle, which has no yaw"),),
    )
    episode_length: float = 6.0
    tolerance: float = 0.03
    """Metres."""
    observations: ClothLiftingObservations = field(default_factory=ClothLiftingObservations)
    rewards: ClothLiftingRewards = field(default_factory=ClothLiftingRewards)
    terminations: cloth.TimeLimit = field(default_factory=cloth.TimeLimit)
    events: ClothLiftingEvents = field(default_factory=ClothLiftingEvents)
    commands: ClothLiftingCommands = field(default_factory=ClothLiftingCommands)

    def scene(self) -> Scene:
        return self.on_bench(
            self.cloth((0.5, 0.0, TRAY)),
            cloth.tray((0.5, 0.6, TRAY), 0.5),
            markers=(MarkerSpec("goal", MarkerShape.SPHERE, size=0.03),),
        )

    def success(self, env: Environment) -> Tensor:
        return goal_distance(env) < self.tolerance

    def metrics(self, env: Environment) -> dict[str, Tensor]:
        return {"goal_distance_m": goal_distance(env)}

    def expert(self, env: Environment) -> Expert:
        # A clone closes the fingers some steps sooner or later than the expert did: on the cloth neither matters.
        phases = (*cloth.pinching(env.world, rest=0.3), Phase(at_goal, gripper_open=False))
        return Expert(env, phases, position_lead=0.05)
