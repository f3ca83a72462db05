"""Soft-Lifting: grasp a soft block on the table by friction and hold it at a sampled position."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import partial
from typing import ClassVar

from torch import Tensor
from torch.linalg import vector_norm

from orbit_core.envs import CommandTerm, Environment, EventTerm, ObservationGroup, ObservationTerm, RewardTerm
from orbit_core.envs.state import TaskState
from orbit_core.envs.task import TaskMetadata
from orbit_core.envs.terms import ENVIRONMENT, Bounds, Meaning, once_per_state
from orbit_core.mdp import common
from orbit_core.mdp.commands import UniformPositionCommand, generated_command
from orbit_core.scene import Scene
from orbit_motion.experts import Expert, Phase
from orbit_tasks import soft
from orbit_tasks.cloth import Smoothness
from orbit_tasks.lift import GOAL
from orbit_tasks.mdp import matter, stages, tabletop
from orbit_tasks.soft import BLOCK, block_turn, lifted, middle, reaching, squeeze

# Metres in x and y by which the block starts off its place.
SPREAD = (0.08, 0.2)


@once_per_state
def block_to_goal(env: Environment[SoftLifting]) -> Tensor:
    """(N, 3) m from the block's middle to the goal."""
    return env.commands["goal"] - middle(env)


@once_per_state
def goal_distance(env: Environment[SoftLifting]) -> Tensor:
    """(N,) metres between the block's middle and the goal."""
    return vector_norm(block_to_goal(env), dim=1)


@once_per_state
def hand_to_block(env: Environment[SoftLifting]) -> Tensor:
    """(N, 3) m from the hand to the block's middle."""
    return middle(env) - common.hand_pose(env)[:, :3]


def _stage(env: Environment[SoftLifting], opening: common.GripperOpening) -> Tensor:
    """(N,) int64: the expert's phase, by the state only."""
    task, hand, grasp = env.task, common.hand_pose(env), soft.at_block(env)
    # In units of uniform compression by the gripper's force. Fingers that strike the block squeeze it by more, and
    # rebound; less is enough to keep a block that is off the table.
    compression = squeeze(env) * (task.youngs_modulus * task.size**2 / task.grip_force)
    held = (compression > 0.5 - 0.3 * lifted(env)) & ((compression < 3.0) | (lifted(env) > 0.0))
    return stages.lifting(hand, grasp, held, closing=opening() < 0.9)


def tracking(env: Environment[SoftLifting], scale: float) -> Tensor:
    """(N,) in [0, 1]: how near a lifted block is to the goal."""
    # Counts once it is lifted: a block that is pushed along the table comes nearer as well.
    return lifted(env) * common.nearness(goal_distance(env), scale)


@dataclass(unsafe_hash=True, kw_only=True)
class SoftGoal(UniformPositionCommand):
    """Position 15 to 35 cm above the table, within 10 cm and 20 cm of the block's place in x and y."""

    marker: str | None = "goal"

    def reach(self, env: Environment) -> dict[str, Bounds]:
        # Above the patch where blocks start, so that every goal is in reach of every arm that reaches the block.
        x = env.world.scene.deformables[0].pose.position[0]
        return {"x": (x - 0.1, x + 0.1), "y": (-0.2, 0.2), "z": (0.15, 0.35)}


def at_goal(env: Environment[SoftLifting]) -> Tensor:
    """(N, 7) the hand that brings the block's middle to the goal, as it hangs in the hand now."""
    return common.pointing_down(env.commands["goal"] + common.hand_pose(env)[:, :3] - middle(env))


@dataclass
class SoftLiftingState(soft.SoftState):
    """The arm's joints and hand, the block's key points, ways to it and to its goal, the last action and the goal."""

    joint_velocities: ObservationTerm | None = ObservationTerm(tabletop.arm_velocities)
    block_turn: ObservationTerm | None = ObservationTerm(block_turn, unit="rad")
    fine_hand_to_block: ObservationTerm | None = tabletop.fine(hand_to_block)
    fine_block_to_goal: ObservationTerm | None = tabletop.fine(block_to_goal)
    fine_squeeze: ObservationTerm | None = tabletop.fine(squeeze, 0.02)
    hand_to_block: ObservationTerm | None = ObservationTerm(hand_to_block, unit="m")
    block_to_goal: ObservationTerm | None = ObservationTerm(block_to_goal, unit="m")
    goal: ObservationTerm | None = ObservationTerm(
        generated_command("goal"),
        unit="m",
        meaning=Meaning("position that the block's middle is to be lifted to", ENVIRONMENT),
    )


@dataclass
class SoftLiftingObservations:
    """State that ``policy`` sees, and ``critic`` as well unless it is given another group."""

    policy: SoftLiftingState = field(default_factory=SoftLiftingState)
    critic: ObservationGroup | None = None


@dataclass
class SoftLiftingRewards(Smoothness):
    """Rewards of the hand at the block, the block off the table and at its goal, less what is fast or abrupt."""

    reach: RewardTerm | None = RewardTerm(reaching, 1.0)
    lift: RewardTerm | None = RewardTerm(lifted, 15.0)
    track: RewardTerm | None = RewardTerm(lambda env: tracking(env, 0.3), 16.0)
    """Nearness of the lifted block to the goal, within some 0.3 m."""
    track_finely: RewardTerm | None = RewardTerm(lambda env: tracking(env, 0.05), 5.0)
    """The same within 0.05 m, which decides the last centimetres."""


@dataclass
class SoftLiftingCommands:
    """The position that the block's middle is to be brought to."""

    goal: CommandTerm | None = SoftGoal()


@dataclass
class SoftLiftingEvents:
    """Robot and block are placed for each episode."""

    place_robot: EventTerm | None = EventTerm(common.randomize_robot_start(0.05))
    place_block: EventTerm | None = EventTerm(matter.place_deformable(BLOCK, SPREAD))


@dataclass(kw_only=True)
class SoftLifting(soft.SoftTask):
    """The block stands anywhere on a patch of the table, turned by any angle; the goal hangs above the table.

    Succeeds when the block's middle is within ``tolerance`` of the goal at the episode's end. Metrics: that distance,
    and by what part of its width the block is squeezed.
    """

    state_type: ClassVar[type[TaskState]] = tabletop.TabletopMemory
    metadata: TaskMetadata = replace(soft.SoftTask.metadata, training={"expert_starts": 0.5, "action": "ik_relative"})
    episode_length: float = 5.0
    tolerance: float = 0.02
    """Metres."""
    observations: SoftLiftingObservations = field(default_factory=SoftLiftingObservations)
    rewards: SoftLiftingRewards = field(default_factory=SoftLiftingRewards)
    terminations: soft.SoftTerminations = field(default_factory=soft.SoftTerminations)
    events: SoftLiftingEvents = field(default_factory=SoftLiftingEvents)
    commands: SoftLiftingCommands = field(default_factory=SoftLiftingCommands)

    def scene(self) -> Scene:
        return self.on_bench((self.block((0.5, 0.0, 0.5 * self.size)),), markers=(GOAL,))

    def success(self, env: Environment) -> Tensor:
        return goal_distance(env) < self.tolerance

    def metrics(self, env: Environment) -> dict[str, Tensor]:
        return {"goal_distance_m": goal_distance(env), "squeeze": squeeze(env)}

    def expert(self, env: Environment) -> Expert:
        phases = (*soft.taking(env.world), Phase(at_goal, gripper_open=False, free=True, least=0.01))
        return Expert(env, phases, stage=partial(_stage, opening=common.GripperOpening(env.world)))
