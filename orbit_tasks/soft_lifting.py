"""Soft-Lifting: grasp a soft block on the table by friction and hold it at a sampled position."""

from __future__ import annotations

from dataclasses import dataclass, field

import torch
from torch import Tensor
from torch.linalg import vector_norm

from orbit_assets.deformables import cuboid
from orbit_assets.objects import BENCH_HEIGHT, work_bench
from orbit_core.envs import (
    CommandTerm,
    Environment,
    EventTerm,
    ObservationGroup,
    ObservationTerm,
    RewardTerm,
    Task,
    TerminationTerm,
)
from orbit_core.envs.ppo import PpoSettings
from orbit_core.envs.task import TaskCheck, TaskException, TaskMetadata
from orbit_core.envs.terms import ENVIRONMENT, Bounds, Meaning, once_per_state
from orbit_core.mdp import common
from orbit_core.mdp.commands import UniformPositionCommand, generated_command
from orbit_core.scene import KeyPoint, Pose, Scene, SoftBody
from orbit_motion import workspace as task_robots
from orbit_motion.experts import Expert, Phase
from orbit_tasks.lift import GOAL
from orbit_tasks.mdp import matter, picking

BLOCK = "block"
# Squares of the block's surface along each edge.
COUNTS = (4, 4, 4)
# Metres in x and y by which the block starts off its place.
SPREAD = (0.08, 0.2)
# Key points of opposite sides.
PAIRS = (("front", "back"), ("left", "right"))


@once_per_state
def middle(env: Environment[SoftLifting]) -> Tensor:
    """(N, 3) the block's middle, in the environment's frame."""
    return env.world.deformables[BLOCK].key_point("middle")


@once_per_state
def yaw(env: Environment[SoftLifting]) -> Tensor:
    """(N,) rad that the block is turned about the vertical, by the way from its middle to its front."""
    # From the middle and not from the other side: a block that is squeezed aslant still faces forwards.
    way = env.world.deformables[BLOCK].key_point("front") - middle(env)
    return torch.atan2(way[:, 1], way[:, 0])


@once_per_state
def goal_distance(env: Environment[SoftLifting]) -> Tensor:
    """(N,) metres between the block's middle and the goal."""
    return vector_norm(env.commands["goal"] - middle(env), dim=1)


@once_per_state
def squeeze(env: Environment[SoftLifting]) -> Tensor:
    """(N,) part of its width that the block is narrower by, between its two sides that are nearer to each other."""
    points = env.world.deformables[BLOCK].key_points
    names = [point.name for point in env.world.deformables[BLOCK].spec.key_points]
    # The hand takes it by either pair of sides, and the one that it takes is the narrower.
    ends = [vector_norm(points[:, names.index(a)] - points[:, names.index(b)], dim=1) for a, b in PAIRS]
    return 1.0 - torch.minimum(*ends) / env.task.size


def reaching(env: Environment[SoftLifting]) -> Tensor:
    """(N,) in [0, 1]: how near the hand is to the block."""
    return common.nearness(vector_norm(middle(env) - common.hand_pose(env)[:, :3], dim=1), 0.1)


@once_per_state
def lifted(env: Environment[SoftLifting]) -> Tensor:
    """(N,) 1 where the block's middle is its size above the table, else 0."""
    return (middle(env)[:, 2] > env.task.size).float()


def dropped(env: Environment[SoftLifting]) -> Tensor:
    """(N,) bool: the block fell off the table."""
    return middle(env)[:, 2] < -0.05


def tracking(env: Environment[SoftLifting], scale: float) -> Tensor:
    """(N,) in [0, 1]: how near a lifted block is to the goal."""
    return lifted(env) * common.nearness(goal_distance(env), scale)


@dataclass(unsafe_hash=True, kw_only=True)
class SoftGoal(UniformPositionCommand):
    """Position 15 to 35 cm above the table, within 10 cm and 20 cm of the block's place in x and y."""

    marker: str | None = "goal"

    def reach(self, env: Environment) -> dict[str, Bounds]:
        # Above the patch where blocks start, so that every goal is in reach of every arm that reaches the block.
        x = env.world.scene.deformables[0].pose.position[0]
        return {"x": (x - 0.1, x + 0.1), "y": (-0.2, 0.2), "z": (0.15, 0.35)}


def at_block(env: Environment[SoftLifting]) -> Tensor:
    """(N, 7) the hand around the block, fingers along the pair of faces that needs the least turn."""
    turn = common.facing_down(picking.quarter(yaw(env)))
    return torch.cat((middle(env), turn), dim=1)


def at_goal(env: Environment[SoftLifting]) -> Tensor:
    """(N, 7) the hand that brings the block's middle to the goal, as it hangs in the hand now."""
    return common.pointing_down(env.commands["goal"] + common.hand_pose(env)[:, :3] - middle(env))


def key_points() -> tuple[KeyPoint, ...]:
    """Key points of the block: the middles of its sides, and the mean of these."""
    # Vertices are numbered alike at every size, so a block of 2 m has its sides at 1.
    points = cuboid((2.0, 2.0, 2.0), COUNTS).vertices
    sides = {"front": (1, 0, 0), "back": (-1, 0, 0), "left": (0, 1, 0), "right": (0, -1, 0)}
    found = {name: int(abs(points - side).sum(axis=1).argmin()) for name, side in sides.items()}
    return (*(KeyPoint(name, (place,)) for name, place in found.items()), KeyPoint("middle", tuple(found.values())))


@dataclass
class SoftLiftingState(ObservationGroup):
    """The arm's joints and hand, the block's key points, the goal and the last action."""

    joint_positions: ObservationTerm | None = ObservationTerm(common.joint_positions)
    joint_velocities: ObservationTerm | None = ObservationTerm(common.joint_velocities)
    hand_pose: ObservationTerm | None = ObservationTerm(common.hand_pose)
    key_points: ObservationTerm | None = ObservationTerm(matter.key_points(BLOCK))
    goal: ObservationTerm | None = ObservationTerm(
        generated_command("goal"),
        unit="m",
        meaning=Meaning("position that the block's middle is to be lifted to", ENVIRONMENT),
    )
    last_action: ObservationTerm | None = ObservationTerm(common.last_action)


@dataclass
class SoftLiftingObservations:
    """Policy and critic see the state."""

    policy: SoftLiftingState = field(default_factory=SoftLiftingState)
    critic: ObservationGroup | None = None


@dataclass
class SoftLiftingRewards:
    """Rewards of the hand at the block, the block off the table and at its goal, less what is fast or abrupt."""

    reach: RewardTerm | None = RewardTerm(reaching, 1.0)
    lift: RewardTerm | None = RewardTerm(lifted, 15.0)
    track: RewardTerm | None = RewardTerm(lambda env: tracking(env, 0.3), 16.0)
    track_finely: RewardTerm | None = RewardTerm(lambda env: tracking(env, 0.05), 5.0)
    action_rate: RewardTerm | None = RewardTerm(common.action_rate, -1e-4)
    joint_speed: RewardTerm | None = RewardTerm(common.joint_speed, -1e-4)


@dataclass
class SoftLiftingTerminations:
    """An episode ends early where the block is dropped off the table."""

    dropped: TerminationTerm | None = TerminationTerm(dropped)


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
class SoftLifting(Task):
    """The block stands anywhere on a patch of the table, turned by any angle; the goal hangs above the table.

    Succeeds when the block's middle is within ``tolerance`` of the goal at the episode's end. Metrics: that distance,
    and by what part of its width the block is squeezed.
    """

    robot: str = "franka_panda"
    action: str = "joint_position"
    physics_dt: float = 0.0025
    decimation: int = 8
    episode_length: float = 5.0
    metadata: TaskMetadata = TaskMetadata(
        ppo=PpoSettings(iterations=1000, initial_std=0.3, entropy_weight=0.005),
        exceptions=(TaskException(TaskCheck.START_YAW, "deformables are sampled by their middle, which has no yaw"),),
    )
    size: float = 0.05
    """Metres of the block's edges."""
    # Foam rubber: light enough for 5 N of grip, and soft enough to be seen to yield.
    density: float = 500.0
    """kg/m^3 of the block."""
    youngs_modulus: float = 1e5
    """Pa of the block: rubber foam has 1e4 to 1e6."""
    friction: float = 1.0
    """Of the block with everything."""
    grip_force: float = 5.0
    """Newtons at most that the gripper closes with; 20 N squeeze a block of 5e4 Pa to half its width."""
    tolerance: float = 0.02
    """Metres."""
    observations: SoftLiftingObservations = field(default_factory=SoftLiftingObservations)
    rewards: SoftLiftingRewards = field(default_factory=SoftLiftingRewards)
    terminations: SoftLiftingTerminations = field(default_factory=SoftLiftingTerminations)
    events: SoftLiftingEvents = field(default_factory=SoftLiftingEvents)
    commands: SoftLiftingCommands = field(default_factory=SoftLiftingCommands)

    def scene(self) -> Scene:
        block = SoftBody(
            BLOCK,
            cuboid((self.size, self.size, self.size), COUNTS),
            self.density,
            Pose((0.5, 0.0, 0.5 * self.size)),
            self.youngs_modulus,
            friction=self.friction,
            key_points=key_points(),
        )
        return Scene(
            robots=(matter.with_grip_force(task_robots.arm(self.robot), self.grip_force),),
            objects=(work_bench(),),
            deformables=(block,),
            terrain=(common.floor(-BENCH_HEIGHT),),
            markers=(GOAL,),
            physics_dt=self.physics_dt,
        )

    def success(self, env: Environment) -> Tensor:
        return goal_distance(env) < self.tolerance

    def metrics(self, env: Environment) -> dict[str, Tensor]:
        return {"goal_distance_m": goal_distance(env), "squeeze": squeeze(env)}

    def expert(self, env: Environment) -> Expert:
        # Longer than a rigid cube takes: the block yields before the fingers hold it.
        closing = max(0.6, common.closing_time(env.world))
        return Expert(
            env,
            (
                Phase(picking.raised(at_block, 0.1), position_tolerance=0.02, free=True),
                Phase(at_block, position_tolerance=0.006, timeout=1.5),
                Phase(at_block, gripper_open=False, dwell=closing, timeout=closing + 0.1),
                Phase(at_goal, gripper_open=False, free=True),
            ),
        )
