"""Reach: bring the end effector to a sampled pose."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any, ClassVar

from torch import Tensor
from torch.linalg import vector_norm

from orbit_assets.objects import BENCH_HEIGHT, work_bench
from orbit_core.dynamics.transforms import pose_error
from orbit_core.envs import (
    CommandTerm,
    Environment,
    EventTerm,
    EventTime,
    ObservationGroup,
    ObservationTerm,
    RewardTerm,
    Task,
)
from orbit_core.envs.ppo import PpoSettings
from orbit_core.envs.task import TaskMetadata
from orbit_core.envs.terms import ENVIRONMENT, POSE, Meaning, once_per_state
from orbit_core.mdp import common, randomize
from orbit_core.mdp.commands import UniformPoseCommand, generated_command
from orbit_core.mdp.randomize import Range
from orbit_core.scene import MarkerShape, MarkerSpec, Scene
from orbit_motion import workspace as task_robots
from orbit_motion.experts import Expert, Phase
from orbit_tasks.mobile import sag_rate
from orbit_tasks.pixels import ArmPixels


@once_per_state
def goal_error(env: Environment[Reach]) -> Tensor:
    """(N, 6) position and rotation vector from the hand to the goal."""
    return pose_error(common.hand_pose(env), env.commands["goal"])


@once_per_state
def position_error(env: Environment[Reach]) -> Tensor:
    """(N,) metres."""
    return vector_norm(goal_error(env)[:, :3], dim=1)


@once_per_state
def rotation_error(env: Environment[Reach]) -> Tensor:
    """(N,) radians."""
    return vector_norm(goal_error(env)[:, 3:], dim=1)


def near(env: Environment[Reach]) -> Tensor:
    """(N,) in [0, 1]: 1 at the goal, falling within a decimetre."""
    return common.nearness(position_error(env), 0.1)


@dataclass
class ReachState(ObservationGroup):
    """The arm's joints and hand, the goal and the last action."""

    joint_positions: ObservationTerm | None = ObservationTerm(common.joint_positions)
    joint_velocities: ObservationTerm | None = ObservationTerm(common.joint_velocities)
    hand_pose: ObservationTerm | None = ObservationTerm(common.hand_pose)
    goal: ObservationTerm | None = ObservationTerm(
        lambda env: env.commands["goal"],
        unit=POSE,
        meaning=Meaning("pose that the end effector is to reach", ENVIRONMENT),
    )
    last_action: ObservationTerm | None = ObservationTerm(common.last_action)


@dataclass
class ReachObservations:
    """State that ``policy`` sees, and ``critic`` as well unless it is given another group."""

    policy: ReachState = field(default_factory=ReachState)
    critic: ObservationGroup | None = None


@dataclass
class ReachPixelObservations:
    """Pictures for ``policy``; the state for ``critic`` and ``teacher``."""

    policy: ArmPixels = field(default_factory=ArmPixels)
    critic: ObservationGroup | None = field(default_factory=ReachState)
    teacher: ObservationGroup | None = field(default_factory=ReachState)


@dataclass
class ReachRewards:
    """Rewards of the hand's position and rotation at the goal, less what is fast or abrupt."""

    # None = RewardTerm(position_error, -2.0) | A cost in metres leads from anywhere, nearness decides the last
    # decimetre.
    position: RewardTerm | None = RewardTerm(position_error, -2.0)
    position_finely: RewardTerm | None = RewardTerm(near, 1.0)
    rotation: RewardTerm | None = RewardTerm(rotation_error, -0.5)
    action_rate: RewardTerm | None = RewardTerm(common.action_rate, -1e-3)
    joint_speed: RewardTerm | None = RewardTerm(common.joint_speed, -1e-3)


@dataclass
class ReachTerminations:
    """Only the time limit ends an episode."""


@dataclass
class ReachCommands:
    """The goal: a pose in the hand's workspace, within the tilt and the yaw that the hand takes everywhere there."""

    goal: CommandTerm | None = UniformPoseCommand(marker="goal")


@dataclass
class ReachEvents:
    """The robot is placed for each episode; masses and the like with domain randomisation."""

    place_robot: EventTerm | None = EventTerm(common.randomize_robot_start(0.2))
    masses: EventTerm | None = None
    """Masses of the arm's links, drawn for each environment; set by domain randomisation."""
    gains: EventTerm | None = None
    """Scales of the arm's stiffness and damping; set by domain randomisation."""


@dataclass(kw_only=True)
class Reach(Task):
    """The goal is a pose in front of the robot, the hand more or less downwards.

    Succeeds when position and orientation are within tolerance at the episode's end. Metrics: both distances.
    """

    renamed: ClassVar[Mapping[str, str]] = {"events.sample_goal": "commands.goal"}
    observation_presets: ClassVar[Mapping[str, Callable[[], Any]]] = {"pixels": ReachPixelObservations}
    robot: str = "franka_panda"
    action: str = "joint_position"
    episode_length: float = 4.0
    metadata: TaskMetadata = TaskMetadata(
        instruction="move the hand to the goal",
        ppo=PpoSettings(iterations=500, initial_std=0.3),
    )
    position_tolerance: float = 0.02
    """Metres."""
    rotation_tolerance: float = 0.1
    """Radians."""
    observations: ReachObservations | ReachPixelObservations = field(default_factory=ReachObservations)
    rewards: ReachRewards = field(default_factory=ReachRewards)
    terminations: ReachTerminations = field(default_factory=ReachTerminations)
    events: ReachEvents = field(default_factory=ReachEvents)
    commands: ReachCommands = field(default_factory=ReachCommands)

    def scene(self) -> Scene:
        return Scene(
            # A workspace of any size will do: goals are drawn within what the arm reaches.
            robots=(task_robots.arm(self.robot, gripper=False, room=(0.0, 0.0, 0.0)),),
            objects=(work_bench(),),
            terrain=(common.floor(-BENCH_HEIGHT),),
            markers=(MarkerSpec("goal", MarkerShape.FRAME, size=0.15),),
            physics_dt=self.physics_dt,
        )

    def randomize(self) -> None:
        """The arm's masses and gains, and noise on its joints."""
        masses = randomize.masses(common.ROBOT, Range(0.9, 1.1))
        self.events.masses = EventTerm(masses, EventTime.STARTUP)
        self.events.gains = EventTerm(randomize.uncertain_gains(common.ROBOT), EventTime.STARTUP)
        common.add_noise(self.observations.policy, joint_positions=0.005, joint_velocities=0.05)

    def success(self, env: Environment) -> Tensor:
        near_enough = position_error(env) < self.position_tolerance
        return near_enough & (rotation_error(env) < self.rotation_tolerance)

    def metrics(self, env: Environment) -> dict[str, Tensor]:
        return {"position_error_m": position_error(env), "rotation_error_rad": rotation_error(env)}

    def expert(self, env: Environment) -> Expert:
        # One phase that never ends: the goal stays, and success is judged at the episode's end.
        goal = Phase(generated_command("goal"), free=True)
        return Expert(env, (goal,), sag_rate=sag_rate(env.world))
